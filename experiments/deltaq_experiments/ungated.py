"""A camera controller and a leader that no gate stops: what the controllers ask for is what the drives get.

Only the limits that the controllers themselves keep are left. The drives lag as those of the emulated controllers.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.held_back import HeldBack
from deltaq_controllers.interface import Controller, RobotView, View
from deltaq_emulator.servo import Servo
from deltaq_experiments.options import Options
from deltaq_experiments.scene import FOLLOWER, LEADER, added_delay_cycles
from deltaq_experiments.trace import Trace
from deltaq_experiments.virtual import RunRecord
from deltaq_protocol.arrays import Array
from deltaq_verification.counts import GateCounts


class _Arm:
    """A robot that goes where it is sent."""

    def __init__(self, cell: CellModel, name: str, q: Array) -> None:
        cycle_s = cell.description.cycle_s
        self._servo = Servo(q, cell.robots[name].description.servo_lag, cycle_s)
        self._setpoint, self._cycle_s = q.copy(), cycle_s
        self.q: list[Array] = []
        self.setpoints: list[Array] = []

    def seen(self, cycle: int) -> RobotView:
        return RobotView(cycle, cycle * self._cycle_s, self._servo.q.copy(), self._setpoint.copy())

    def go(self, dq: Array) -> None:
        self._setpoint = self._setpoint + dq
        self._servo.advance(self._setpoint)
        self.q.append(self._servo.q.copy())
        self.setpoints.append(self._setpoint)


def record_ungated(
    options: Options, cell: CellModel, camera: Controller, leader: Controller, start: Mapping[str, Array]
) -> RunRecord:
    """Run both without services.

    Args:
        options: with `length_s` known.
        cell: the cell.
        camera: moves the robot with the camera; it sees the leader as old as the latency wants it.
        leader: moves the leader; it sees both robots' newest.
        start: (n,) configuration of both [rad or m].

    Raises:
        DeltaqError: if the loop alone is slower than the latency asked for.
    """
    cycle_s = cell.description.cycle_s
    late_camera = HeldBack(camera, added_delay_cycles(cell, options.latency_s))
    arms = {name: _Arm(cell, name, start[name]) for name in (FOLLOWER, LEADER)}
    cycles = max(1, round(options.length_s / cycle_s))
    for cycle in range(cycles):
        own, other = (arm.seen(cycle) for arm in arms.values())
        arms[LEADER].go(leader.increment(View(other, {FOLLOWER: own})))
        arms[FOLLOWER].go(late_camera.increment(View(own, {LEADER: other})))
    trace = Trace(
        np.arange(cycles, dtype=np.float64) * cycle_s,
        {name: np.array(arm.q) for name, arm in arms.items()},
        {name: np.array(arm.setpoints) for name, arm in arms.items()},
    )
    return RunRecord(trace, GateCounts(), {})
