"""Snapshots of a Robot Server: from each another goes on, to the bit, as the one that it was taken of."""

import random

import krc_side
import numpy as np
import pytest
from krc_side import CELL, FR, XML
from remembered import remembered
from telegram_storm import Storm

from deltaq_protocol.guarded import Supervision
from deltaq_protocol.messages import Increment, Phase
from deltaq_protocol.rsi import TelegramError
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver, sensor_codec

CODEC = sensor_codec(CELL, "fr", XML)


def told(server):
    """What it remembers once it has told its state."""
    assert server.state is None or server.state.robot == "fr"
    return remembered(server)


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
        assert told(heir) == told(self)
        assert (heir.detail, heir.at_rest) == (self.detail, self.at_rest)
        return q_cmd

    def krc_silent(self, time_s):
        heir = self._heir()
        super().krc_silent(time_s)
        heir.krc_silent(time_s)
        assert told(heir) == told(self)


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
def test_in_a_storm_of_telegrams_a_restored_snapshot_behaves_identically(monkeypatch, seed):
    monkeypatch.setattr(krc_side, "RobotServer", WatchedServer)
    monkeypatch.setattr(krc_side, "RsiDriver", WatchedDriver)
    before = WatchedServer.steps
    storm = Storm(seed)
    storm.run(1500)
    assert storm.admitted > 20
    assert WatchedServer.steps - before > 300


def test_messages_one_by_one_and_all_in_one_cycle_have_the_same_effect():
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
        assert told(pieces) == told(whole)
        outputs.append(setpoint)
        q = setpoint.q_cmd
    assert pieces.state.phase in (Phase.READY, Phase.HELD)


def test_a_robot_server_refuses_foreign_messages_by_type():
    server = RobotServer(CELL, "fr", process=1)
    with pytest.raises(TypeError, match="takes admissions, heartbeats and measurements, got a Increment"):
        server.take(Increment(robot="fr", seq=1, cycle=1, dq=(0.0,) * 6), 0.0)
