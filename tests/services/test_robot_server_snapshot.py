"""Snapshots of a Robot Server: from each another goes on, to the bit, as the one that it was taken of."""

import random
from dataclasses import replace

import krc_side
import numpy as np
import pytest
from krc_side import CELL, FR, XML, KrcSide
from telegram_storm import Storm

from deltaq_protocol.guarded import Supervision
from deltaq_protocol.messages import Increment, Phase
from deltaq_protocol.rsi import TelegramError
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.krc_file import sensor_codec
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.mode_probe import ModeProbe
from deltaq_services.robot_server.peer import Peer
from deltaq_services.robot_server.rsi_driver import RsiDriver

CODEC = sensor_codec(CELL, "fr", XML)


def uncounted(memory):
    """Counters are left out of a snapshot, and so of the state that an heir publishes."""
    state = memory.state
    return replace(memory, state=state if state is None else state.model_copy(update={"counters": {}}))


class WatchedServer(RobotServer):
    """At each step another takes its place, and has to come to the same."""

    steps = 0

    def _heir(self):
        WatchedServer.steps += 1
        heir = RobotServer(CELL, "fr", process=99)
        heir.restore(self.snapshot())
        return heir

    def cycle(self, measured, time_s, admission=None, supervision=None):
        heir = self._heir()
        q_cmd = super().cycle(measured, time_s, admission, supervision)
        assert (heir.cycle(measured, time_s, admission, supervision) == q_cmd).all()
        assert uncounted(heir.snapshot()) == uncounted(self.snapshot())
        assert (heir.detail, heir.at_rest) == (self.detail, self.at_rest)
        return q_cmd

    def krc_silent(self, time_s):
        heir = self._heir()
        super().krc_silent(time_s)
        heir.krc_silent(time_s)
        assert uncounted(heir.snapshot()) == uncounted(self.snapshot())


class WatchedDriver(RsiDriver):
    """The same of a driver."""

    def read(self, datagram, time_s):
        heir = RsiDriver(CODEC, CELL, "fr", self._counters.copy())
        heir.restore(self.snapshot())
        try:
            measured = super().read(datagram, time_s)
        except TelegramError:
            with pytest.raises(TelegramError):
                heir.read(datagram, time_s)
            return None
        again = heir.read(datagram, time_s)
        assert (again is None) == (measured is None)
        assert (heir.unmoved, heir.implausible) == (self.unmoved, self.implausible)
        if measured is not None:
            assert (again.q == measured.q).all()
            assert (again.ipoc, again.missed_last) == (measured.ipoc, measured.missed_last)
            assert np.array_equal(again.q_start, measured.q_start)
            q_cmd = measured.q if measured.q_start is None else measured.q_start
            heir.restore(self.snapshot())
            other = RsiDriver(CODEC, CELL, "fr", self._counters.copy())
            other.restore(heir.snapshot())
            assert heir.reply(q_cmd, {}) == other.reply(q_cmd, {})
        return measured


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_in_a_storm_of_telegrams_another_may_take_its_place_at_any_moment(monkeypatch, seed):
    monkeypatch.setattr(krc_side, "RobotServer", WatchedServer)
    monkeypatch.setattr(krc_side, "RsiDriver", WatchedDriver)
    before = WatchedServer.steps
    storm = Storm(seed)
    storm.run(1500)
    assert storm.admitted > 20
    assert WatchedServer.steps - before > 300


def test_a_snapshot_leaves_out_nothing_but_what_is_fixed_and_what_is_counted():
    remembered = {
        "process", "motion_stop", "outputs", "_cycle", "_phase", "_reason", "_motion", "_q_reset",
        "_epoch", "_resets", "_cycles_without_gate", "_cycles_missed", "_settling", "_told",
        "_state", "_mode", "_lag", "_unwatched", "_pulses", "_admissions", "_supervision",
    }  # fmt: skip
    fixed = {
        "robot",
        "counters",
        "containment",
        "guarded",
        "_identity",
        "_bounds",
        "_new_mode",
        "_new_lag_watch",
        "_gate_timeout_cycles",
        "_krc_timeout_cycles",
    }
    server = RobotServer(CELL, "fr", process=1)
    assert set(vars(server)) == remembered | fixed
    probe = ModeProbe(FR, CELL.cycle_s, 6, FR.home)
    fixed = {
        "_joints",
        "_size",
        "_trial",
        "_presumed_window",
        "_presumed_s",
        "_cycle_s",
        "_course",
        "trial_cycles",
    }
    remembered = {f"_{name}" for name in ("q_start", "offset", "adrift_cycles", "ended", "ipoc", "ipoc_step")}
    remembered |= {"mode", "unseen", "_cycle", "_samples", "_cycles", "_void", "lags", "_lagging"}
    assert set(vars(probe)) == remembered | fixed


def test_a_driver_and_its_peer_leave_out_nothing_either():
    krc = KrcSide()
    of_one_call = {"unmoved", "implausible", "fault", "detail"}
    fixed = {"_codec", "_counters", "_plausible", "_near", "_most", "_widest", "_zero"}
    remembered = {
        "session",
        "meter",
        "_origin",
        "_lower",
        "_upper",
        "_sent",
        "_earlier",
        "_opened",
        "_outputs",
    }
    assert set(vars(krc.driver)) == remembered | fixed | of_one_call
    fixed = {"_given_step", "_plausible", "_near", "_cycle_s", "_silence_s", "_silence_cycles", "_least_s"}
    assert set(vars(krc.driver.session)) == {"belief", "step", "last", "_time_s", "_run"} | fixed
    peer = Peer(None, 0.5)
    assert set(vars(peer)) == {"address", "_heard_s"} | {"stranger", "_krc_address", "_silence_s"}
    peer.believed(("127.0.0.1", 7), 3.0)
    heir = Peer(None, 0.5)
    heir.restore(peer.snapshot())
    assert heir.judge(("127.0.0.1", 8), 3.4) == peer.judge(("127.0.0.1", 8), 3.4)
    assert heir.snapshot() == peer.snapshot()


def test_a_server_that_takes_one_message_after_the_other_does_as_one_that_is_handed_all_in_its_cycle():
    pieces, whole = (RobotServer(CELL, "fr", process=1) for _ in range(2))
    random_ = random.Random(5)
    q, outputs = FR.home, []
    for cycle in range(200):
        heartbeat = None
        if random_.random() < 0.8:
            identity = pieces._identity
            heartbeat = Supervision(robot="fr", epoch=3, cycle=cycle, cell=identity, resets=cycle // 50)
            assert pieces.take(heartbeat.model_copy(update={"epoch": 2}), 0.0) == []  # the newest counts
            assert pieces.take(heartbeat, 0.0) == []
        measured = Measurement(12 * cycle, q, q if cycle == 0 else None)
        (setpoint,) = pieces.take(measured, 0.012 * cycle)
        assert (setpoint.q_cmd == whole.cycle(measured, 0.012 * cycle, None, heartbeat)).all()
        assert (setpoint.outputs, setpoint.motion_stop) == (whole.outputs, whole.motion_stop)
        assert pieces.snapshot() == whole.snapshot()
        outputs.append(setpoint)
        q = setpoint.q_cmd
    assert pieces.state.phase in (Phase.READY, Phase.HELD)


def test_what_nobody_sends_to_a_robot_server_is_refused_by_its_type():
    server = RobotServer(CELL, "fr", process=1)
    with pytest.raises(TypeError, match="takes admissions, heartbeats and measurements, got a Increment"):
        server.take(Increment(robot="fr", seq=1, cycle=1, dq=(0.0,) * 6), 0.0)
