"""A camera controller and a leader that no gate stops: what the controllers ask for is what the drives get.

Only the limits that the controllers themselves keep are left. The drives lag as those of the emulated controllers.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.held_back import HeldBack
from deltaq_controllers.interface import Controller, RobotView
from deltaq_emulator.servo import Servo
from deltaq_experiments.options import Options
from deltaq_experiments.scene import added_delay_cycles
from deltaq_experiments.trace import Trace
from deltaq_experiments.virtual import RunRecord, view_of
from deltaq_protocol.arrays import Array
from deltaq_verification.counts import GateCounts


class _Arm:
    """A robot that goes where it is sent."""

    def __init__(self, robot: RobotModel, cycle_s: float, q: Array) -> None:
        self._servo = Servo(q, robot.description.servo_lag, cycle_s)
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
    options: Options, scene: Scene, camera: Controller, leader: Controller, start: Mapping[str, Array]
) -> RunRecord:
    """Run them without services.

    Args:
        options: with `length_s` known.
        scene: who watches whom; other robots of the cell stand still.
        camera: moves the robot with the camera; it sees the others as old as the latency wants it.
        leader: moves the leader; it sees the others' newest.
        start: (n,) configuration of each robot that does not start at home [rad or m].

    Raises:
        DeltaqError: if the loop alone is slower than the latency asked for.
    """
    cycle_s = scene.cycle_s
    late_camera = HeldBack(camera, added_delay_cycles(scene, options.latency_s))
    robots = scene.cell.robots
    arms = {name: _Arm(robot, cycle_s, start.get(name, robot.home)) for name, robot in robots.items()}
    cycles = max(1, round(options.length_s / cycle_s))
    for cycle in range(cycles):
        views = {name: arm.seen(cycle) for name, arm in arms.items()}
        asked = {name: np.zeros(robot.n) for name, robot in robots.items()}
        asked[scene.leader_name] = leader.increment(view_of(views, scene.leader_name))
        asked[scene.robot_name] = late_camera.increment(view_of(views, scene.robot_name))
        for name, arm in arms.items():
            arm.go(asked[name])
    trace = Trace(
        np.arange(cycles, dtype=np.float64) * cycle_s,
        {name: np.array(arm.q) for name, arm in arms.items()},
        {name: np.array(arm.setpoints) for name, arm in arms.items()},
    )
    return RunRecord(trace, GateCounts(), {})
