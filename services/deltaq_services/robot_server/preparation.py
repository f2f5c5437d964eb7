"""Gets a reply ready while there is time: what the next telegram leads to if it is the one that is expected.

Nothing is decided here. The Robot Server's own core goes ahead, as another from a snapshot, and when the telegram has
been answered it decides on it as on any other. What has to be known before is where the measured joints make no
difference to the reply: wherever the telegram is plausible, the robot is not held for being where it was not sent, and
its probe does not count it as adrift. Those are the bounds of a prepared reply, each a hair tighter than its check.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from deltaq_cell.description import CellDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import AxisMap
from deltaq_protocol.rsi.usual_telegram import UsualTelegrams
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.crash_brake.record_maker import CrashRecordMaker
from deltaq_services.robot_server.expected_telegram import ExpectedTelegram
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.mode_probe import ADRIFT, ModeProbe
from deltaq_services.robot_server.plausibility import Plausibility
from deltaq_services.robot_server.prepared_reply import PreparedReply
from deltaq_services.robot_server.probe_trial import Mode, pulse_sums
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.robot_server.session import IPOC_WRAP, Belief
from deltaq_services.robot_server.snapshot import ServerMemory

_HAIR = 1e-9
"""By which bounds are tighter, of a value and absolute: more than all that numbers are rounded by on the way."""

_Range = tuple[Array, Array]
"""Lower and upper bounds of the joints, each (n,) [rad or m]."""


class Preparation:
    """Prepares the replies of one robot.

    Args:
        cell: the cell.
        server: its core, which is only read.
        rsi: its driver, which only computes what it would send.
        telegrams: reads the telegrams of its KRC.
        axes: its joints.
        records: makes the records that are written before replies; None if there are none.
    """

    def __init__(
        self,
        cell: CellDescription,
        server: RobotServer,
        rsi: RsiDriver,
        telegrams: UsualTelegrams,
        axes: AxisMap,
        records: CrashRecordMaker | None = None,
    ) -> None:
        robot = cell.robots[server.robot]
        self._server, self._rsi, self._telegrams, self._records = server, rsi, telegrams, records
        self._ahead = RobotServer(cell, server.robot, server.process)
        self._units = axes.reported
        plausible = Plausibility.of(robot, cell.cycle_s)
        self._possible: _Range = np.array(plausible.lower), np.array(plausible.upper)
        self._reach = np.array(plausible.reach) + np.array(plausible.resolution)
        self._tolerance = robot.tracking_tolerance
        self._lag_cycles = math.ceil(cell.gate.servo_lag_s / cell.cycle_s)
        self._trial_cycles = ModeProbe(robot, cell.cycle_s, self._lag_cycles, robot.home).trial_cycles
        self._adrift = ADRIFT * pulse_sums(robot)

    def after(self, datagram: bytes, stop: bool, time_s: float) -> PreparedReply | None:
        """The reply to the telegram after this one, if it is as expected.

        Args:
            datagram: the telegram answered last, with a setpoint.
            stop: whether the reply has to end the motion in any case.
            time_s: time on a monotonic clock [s].

        Returns:
            The reply; None if it may depend on the robot's position, or no telegram is expected.
        """
        session, telegrams = self._rsi.session, self._telegrams
        last, step = session.last, session.step
        places = telegrams.places(datagram)
        if places is None or last is None or last.q is None or step is None:
            return None
        if session.belief is not Belief.BELIEVED or telegrams.ipoc(datagram) != last.ipoc:
            return None
        memory = self._server.snapshot()
        if memory.supervision is not None and memory.supervision.resets > memory.resets:
            return None
        if self._is_judged_next(memory) and _has_negative_zero(_held_at(memory)):
            return None
        lower, upper = self._calm(memory, last.q)
        if not ((lower <= last.q) & (last.q <= upper)).all():
            return None
        ipoc = (last.ipoc + step) % IPOC_WRAP
        self._ahead.restore(memory)
        (setpoint,) = self._ahead.take(Measurement(ipoc, last.q, inputs=last.inputs), time_s)
        sent = self._rsi.ahead(ipoc, setpoint.q_cmd, setpoint.outputs, stop or setpoint.motion_stop)
        if sent is None:
            return None
        reply, correction = sent
        record = None
        if self._records is not None:
            motion = self._ahead.motion
            left = self._records.record(datagram, ipoc, correction, setpoint.outputs, motion)
            record = self._records.body(left)
            if record is None:
                return None
        expected = telegrams.with_ipoc(datagram, ipoc)
        telegram = ExpectedTelegram.of(expected, places, *self._told_within(lower, upper))
        return PreparedReply(telegram, correction, reply, record)

    def _told_within(self, lower: Array, upper: Array) -> _Range:
        """The same bounds (n,) as the values of a telegram keep to, each a hair within, and none for other values."""
        least, most = lower * self._units, upper * self._units
        least += _HAIR * (1.0 + np.abs(least))
        most -= _HAIR * (1.0 + np.abs(most))
        order = list(self._telegrams.order)
        # what is no joint takes the last place
        return np.append(least, -np.inf)[order], np.append(most, np.inf)[order]

    def _calm(self, memory: ServerMemory, q: Array) -> _Range:
        """Where joints that were at `q` (n,) make no difference to the reply."""
        lower, upper = zip(*self._places(memory, q), strict=True)
        return np.max(lower, axis=0), np.min(upper, axis=0)

    def _places(self, memory: ServerMemory, q: Array) -> Iterator[_Range]:
        yield self._possible
        yield q - self._reach, q + self._reach
        if memory.cycles_at_rest > self._lag_cycles:
            held_at = _held_at(memory)
            yield held_at - self._tolerance, held_at + self._tolerance
        if memory.mode is not None and memory.mode.mode is Mode.UNKNOWN:
            q_start = np.array(memory.mode.q_start)
            yield q_start - self._adrift, q_start + self._adrift

    def _is_judged_next(self, memory: ServerMemory) -> bool:
        """Whether the next telegram ends a trial of the KRC's mode.

        A trial ends at rest, with zero added to the setpoint. Whatever it tells, the reply has the setpoint that the
        KRC has, with that zero or without it, which makes a difference to a negative zero only.
        """
        return memory.mode is not None and memory.mode.cycle + 1 == self._trial_cycles


def _held_at(memory: ServerMemory) -> Array:
    return memory.motion.q_cmd if memory.q_reset is None else np.array(memory.q_reset)


def _has_negative_zero(q: Array) -> bool:
    return bool((np.signbit(q) & (q == 0.0)).any())
