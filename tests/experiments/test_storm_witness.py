"""The witness of RSI's wire: it knows an admission and its brake again, and says so of nothing else."""

import numpy as np
import pytest
from krc_side import CELL, FR, KRC, MAX_DV, XML, KrcSide, telegram

from deltaq_experiments.storm.forger import Forger, Sender
from deltaq_experiments.storm.witness import Kind, Passed, UnexplainedError, Witness
from deltaq_services.robot_server.shell import sensor_codec


class Wire:
    """What passes between a KRC and a Robot Server, and what was admitted."""

    def __init__(self):
        self.krc = KrcSide()
        self.passed, self.admissions = [], []

    def cycle(self, increment=None):
        self.krc.tick()
        own = self.krc.own()
        admission = None if increment is None else self.krc.admission(increment)
        if admission is not None:
            self.admissions.append(admission)
        answer = self.krc.answer(own, admission)
        self.passed.append((Kind.TELEGRAM, own))
        if answer is not None:
            self.passed.append((Kind.REPLY, answer))
            self.krc.correction = KRC.decode(answer).correction

    def begin(self):
        while self.krc.server.state is None or self.krc.server.state.phase != "ready":
            self.cycle()
        return self

    def drive(self):
        for count in (1, 2, 3, 3):
            self.cycle(count * MAX_DV)
        for _ in range(6):
            self.cycle()
        return self

    def judge(self, admissions=None):
        witness = Witness(sensor_codec(CELL, "fr", XML), KRC)
        passed = [Passed(kind, datagram, stamp) for stamp, (kind, datagram) in enumerate(self.passed)]
        witness.judge(passed, self.admissions if admissions is None else admissions)
        return witness.counts


@pytest.fixture
def wire():
    return Wire().begin()


def test_admissions_and_their_brakes_are_told_from_one_another(wire):
    counts = wire.drive().judge()
    assert counts["by an admission"] == 4
    assert counts["by a brake"] == 2
    assert counts["unmoved"] == counts["replies"] - 6


@pytest.mark.parametrize("missing", range(4))
def test_a_step_of_which_the_gate_knows_nothing_is_not_explained(wire, missing):
    wire.drive()
    known = [admission for number, admission in enumerate(wire.admissions) if number != missing]
    with pytest.raises(UnexplainedError, match="moved by"):
        wire.judge(known)


@pytest.mark.parametrize("off_rad", [1e-6, 0.02])
def test_a_reply_that_is_off_by_little_or_much_is_not_explained(wire, off_rad):
    wire.drive().cycle()
    place = len(wire.passed) - 1
    told = KRC.decode(wire.passed[place][1])
    moved = wire.krc.driver._codec.encode(told.ipoc, told.correction + off_rad, {})
    wire.passed[place] = (Kind.REPLY, moved)
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_an_admission_explains_one_step_only(wire):
    wire.drive()
    last = next(place for place, one in enumerate(wire.passed) if one[0] is Kind.REPLY)
    steps = [one for one in wire.passed[last:] if one[0] is Kind.REPLY]
    wire.passed += [steps[0], *steps]  # back to where it began, and the same way again
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_a_session_that_begins_anew_has_no_correction(wire):
    wire.drive()
    krc = wire.krc
    krc.tick(40)
    programmed = krc.q
    wire.passed.append((Kind.TELEGRAM, telegram(krc.ipoc, programmed, programmed)))
    codec = krc.driver._codec
    wire.passed.append((Kind.REPLY, codec.encode(krc.ipoc, np.zeros(6), {})))
    wire.judge()
    wire.passed[-1] = (Kind.REPLY, codec.encode(krc.ipoc, krc.correction, {}))
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_the_forger_makes_every_kind_and_most_of_them_seem_to_be_somebody_else_s():
    forger = Forger(0)
    assert forger.forge() is None
    forger.overhear(telegram(1000, FR.home))
    forged = [forger.forge() for _ in range(20_000)]
    assert {one.kind for one in forged} == set(forger._kinds)
    assert sum(one.sender is not Sender.KRC for one in forged) > 10_000
