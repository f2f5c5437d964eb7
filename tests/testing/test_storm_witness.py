"""The witness of RSI's wire: it knows an admission and its brake again, and says so of nothing else."""

import numpy as np
import pytest
from krc_side import CELL, FR, KRC, MAX_DV, XML, KrcSide, telegram

from deltaq_proofs.storm.forger import ForgedSender, Forger
from deltaq_proofs.storm.witness import (
    ROUNDING,
    UNHEARD,
    Admitted,
    DatagramOrigin,
    Passed,
    Pulses,
    UnexplainedError,
    Witness,
)
from deltaq_services.robot_server.probe_trial import pulse_offsets
from deltaq_services.robot_server.rsi_driver import sensor_codec

PULSES = pulse_offsets(FR, CELL.cycle_s)


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
        self.passed.append((DatagramOrigin.TELEGRAM, own))
        if answer is not None:
            self.passed.append((DatagramOrigin.REPLY, answer))
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
        witness = Witness(sensor_codec(CELL, "fr", XML), KRC, PULSES)
        passed = [Passed(kind, datagram, stamp) for stamp, (kind, datagram) in enumerate(self.passed)]
        heard = self.admissions if admissions is None else admissions
        witness.judge(passed, Admitted(heard, "fr", FR, CELL.cycle_s))
        return witness.counts

    def move_last(self, off):
        """The last reply, with a correction that is off."""
        told = KRC.decode(self.passed[-1][1])
        self.passed[-1] = (
            DatagramOrigin.REPLY,
            self.krc.driver._codec.encode(told.ipoc, told.correction + off, {}),
        )


@pytest.fixture
def wire():
    return Wire().begin()


def test_admissions_brakes_and_probes_are_distinguished(wire):
    counts = wire.drive().judge()
    assert counts["by an admission"] == 4
    assert counts["by a brake"] == 2
    assert counts["by a probe"] == 2 * (len(PULSES) + 1)
    assert counts[UNHEARD] == 0
    assert counts["unmoved"] == counts["replies"] - 6 - counts["by a probe"]


def renumbered(admissions, number):
    """As from a gate that never made the one of this number."""
    return [
        one.model_copy(update={"sequence": one.sequence - (place > number)})
        for place, one in enumerate(admissions)
        if place != number
    ]


@pytest.mark.parametrize("missing", range(4))
def test_a_step_unknown_to_the_gate_is_not_explained(wire, missing):
    wire.drive()
    with pytest.raises(UnexplainedError, match="moved by"):
        wire.judge(renumbered(wire.admissions, missing))


@pytest.mark.parametrize("missing", [1, 2])
def test_a_lost_admission_explains_one_step_and_is_counted_separately(wire, missing):
    wire.drive()
    heard = [one for place, one in enumerate(wire.admissions) if place != missing]
    counts = wire.judge(heard)
    assert (counts["by an admission"], counts[UNHEARD], counts["by a brake"]) == (3, 1, 2)


def test_the_brake_of_a_lost_admission_is_known(wire):
    wire.cycle(MAX_DV)
    wire.cycle(2 * MAX_DV)
    wire.cycle(3 * MAX_DV)
    for _ in range(4):
        wire.cycle()
    wire.cycle(MAX_DV)
    heard = [wire.admissions[0], wire.admissions[1], wire.admissions[3]]
    counts = wire.judge(heard)
    assert (counts["by an admission"], counts[UNHEARD], counts["by a brake"]) == (3, 1, 2)


@pytest.mark.parametrize("share", [1.01, -1.01, 2.0, 50.0])
def test_a_lost_admission_explains_no_other_step(wire, share):
    wire.drive()
    for _ in range(4):
        wire.cycle()
    wire.move_last(share * MAX_DV)
    first, *rest = wire.admissions
    last = first.model_copy(update={"sequence": rest[-1].sequence + 2})
    with pytest.raises(UnexplainedError):
        wire.judge([*wire.admissions, last])


def test_a_lost_admission_explains_no_second_step(wire):
    for _ in range(2):
        wire.cycle(MAX_DV)
        for _ in range(3):
            wire.cycle()
    first, second = wire.admissions
    elsewhere = {"follows_q_cmd": (9.0,) * 6}
    before, after = ({**elsewhere, "sequence": one} for one in (first.sequence - 1, second.sequence + 1))
    around = [first.model_copy(update=before), second.model_copy(update=after)]
    assert wire.judge([*around, first])[UNHEARD] == 1
    assert wire.judge(around)[UNHEARD] == 2
    with pytest.raises(UnexplainedError):
        wire.judge([*around, first.model_copy(update=elsewhere)])


@pytest.mark.parametrize("off_rad", [1e-6, 0.02])
def test_a_wrong_reply_is_not_explained(wire, off_rad):
    wire.drive().cycle()
    wire.move_last(off_rad)
    with pytest.raises(UnexplainedError):
        wire.judge()


@pytest.mark.parametrize("share", [0.9, 1.1, -0.9])
def test_a_step_similar_to_a_probe_is_not_explained(wire, share):
    wire.drive().cycle()
    wire.move_last(share * PULSES[0])
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_a_pulse_that_does_not_return_is_not_explained(wire):
    wire.drive().cycle()
    wire.move_last(PULSES[0])
    assert wire.judge()["by a probe"] == 2 * (len(PULSES) + 1) + 1
    wire.cycle()
    wire.move_last(2 * PULSES[0])
    wire.cycle()
    wire.move_last(1.5 * PULSES[0])
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_an_admission_explains_one_step_only(wire):
    wire.drive()
    last = next(place for place, one in enumerate(wire.passed) if one[0] is DatagramOrigin.REPLY)
    steps = [one for one in wire.passed[last:] if one[0] is DatagramOrigin.REPLY]
    wire.passed += [steps[0], *steps]  # back to where it began, and the same way again
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_a_new_session_has_no_correction(wire):
    wire.drive()
    krc = wire.krc
    krc.tick(40)
    programmed = krc.q
    wire.passed.append((DatagramOrigin.TELEGRAM, telegram(krc.ipoc, programmed, programmed)))
    codec = krc.driver._codec
    wire.passed.append((DatagramOrigin.REPLY, codec.encode(krc.ipoc, np.zeros(6), {})))
    wire.judge()
    wire.passed[-1] = (DatagramOrigin.REPLY, codec.encode(krc.ipoc, krc.correction, {}))
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_a_forgery_with_an_earlier_ipoc_is_answered_in_the_repeated_session():
    wire = Wire()
    krc, codec = wire.krc, wire.krc.driver._codec
    earlier, elsewhere = krc.ipoc, FR.home + 0.01
    wire.passed.append((DatagramOrigin.TELEGRAM, telegram(earlier, elsewhere, elsewhere)))
    wire.passed.append((DatagramOrigin.REPLY, codec.encode(earlier, np.zeros(6), {})))
    krc.tick(40)
    wire.begin().drive()
    assert krc.correction.any()
    sessions = wire.judge()["sessions"]
    wire.passed.append((DatagramOrigin.FORGERY, telegram(earlier, krc.q, krc.q_programmed)))
    wire.passed.append((DatagramOrigin.REPLY, codec.encode(earlier, krc.correction, {})))
    assert wire.judge()["sessions"] == sessions
    wire.move_last(1e-4)
    with pytest.raises(UnexplainedError):
        wire.judge()


def test_the_forger_makes_every_kind_mostly_as_other_senders():
    forger = Forger(0)
    assert forger.forge() is None
    forger.overhear(telegram(1000, FR.home))
    forged = [forger.forge() for _ in range(20_000)]
    assert {one.kind for one in forged} == set(forger._kinds)
    assert sum(one.sender is not ForgedSender.KRC for one in forged) > 10_000


def test_pulses_come_in_any_order_and_each_is_undone_before_the_next():
    pulses = Pulses(PULSES, 2 * ROUNDING)
    steps = np.diff(np.concatenate([np.zeros((1, 6)), PULSES, np.zeros((1, 6))]), axis=0)
    for sign in (1.0, -1.0, -1.0, 1.0):
        assert all(pulses.explains(sign * step) for step in steps)
    for sign in (1.0, -1.0):
        rising = [step for step in steps if step[0] > 0.0]
        assert all(pulses.explains(sign * step) for step in rising)
        assert not pulses.explains(sign * steps[0])  # further than one of them leads
        assert pulses.explains(-sign * sum(rising))
    assert not pulses.begin(np.zeros(6))
    assert all(pulses.explains(-step) for step in steps)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pulse_continues_across_changes_of_session(sign):
    pulses = Pulses(PULSES, 2 * ROUNDING)
    steps = np.diff(np.concatenate([PULSES, np.zeros((1, 6))]), axis=0)
    for offset, step in zip(PULSES, steps, strict=True):
        assert pulses.begin(sign * offset)
        assert pulses.begin(sign * offset)
        assert pulses.explains(sign * step)
    assert not pulses.begin(np.zeros(6))
    assert not pulses.begin(2.0 * PULSES.max() * np.ones(6))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_replies_to_another_session_within_a_pulse_stay_within_its_size(wire, sign):
    wire.drive()
    probed = wire.judge()["by a probe"]
    krc, codec = wire.krc, wire.krc.driver._codec
    here, there = krc.q, krc.q + 0.01
    amplitude = sign * PULSES[len(PULSES) // 2]

    def answered(programmed, correction):
        krc.tick()
        wire.passed.append((DatagramOrigin.TELEGRAM, telegram(krc.ipoc, programmed, programmed)))
        wire.passed.append((DatagramOrigin.REPLY, codec.encode(krc.ipoc, correction, {})))

    for programmed in (here, there, here, there, here):
        answered(programmed, np.zeros(6))
        answered(programmed, np.zeros(6))
    for programmed in (there, here, there):
        answered(programmed, amplitude)
    assert wire.judge()["by a probe"] == probed + 3
    answered(here, amplitude + 1e-4)
    with pytest.raises(UnexplainedError):
        wire.judge()
