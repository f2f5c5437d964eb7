"""The camera follower and its leader in a closed loop of plain kinematics, as the errata's table was made."""

from collections import deque
from dataclasses import dataclass
from functools import cache

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Camera
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.controllers import CameraController
from deltaq_controllers.camera.follower import CameraFollower, FollowerGains
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_protocol.arrays import Array

CYCLE_S = 0.012


@cache
def lab() -> CellModel:
    return CellModel.load("lab")


def with_camera(camera: Camera, urdf: str | None = None) -> RobotModel:
    """The lab's floor robot with another camera."""
    robot = lab().robots["fr"]
    return RobotModel(robot.description.model_copy(update={"camera": camera}), "fr", urdf or robot.urdf)


class Servo:
    """Drives that lag: dead time, then second order, critically damped; or none at all."""

    def __init__(self, q: Array, dead_cycles: int = 1, natural_frequency_rad_s: float = 83.0) -> None:
        self.q, self._v = q.copy(), np.zeros_like(q)
        self._w = natural_frequency_rad_s
        self._waiting = deque([q.copy()] * (dead_cycles + 1), maxlen=dead_cycles + 1)

    def follow(self, q_cmd: Array) -> Array:
        self._waiting.append(q_cmd.copy())
        step_s = CYCLE_S / 12
        for _ in range(12):
            pull = self._w**2 * (self._waiting[0] - self.q) - 2.0 * self._w * self._v
            self._v = self._v + step_s * pull
            self.q = self.q + step_s * self._v
        return self.q


@dataclass
class Run:
    """What came of it, one entry a cycle."""

    angle_deg: Array
    distance_error_m: Array
    violations: int

    def after(self, time_s: float) -> tuple[Array, Array]:
        start = round(time_s / CYCLE_S)
        return self.angle_deg[start:], np.abs(self.distance_error_m[start:])


def limit_violations(robot: RobotModel, q: Array, dq: Array, dq_last: Array) -> int:
    """Number of joints of which an increment passes a limit of position, speed or acceleration."""
    moved = q + dq
    return int(
        np.sum(moved > robot.upper)
        + np.sum(moved < robot.lower)
        + np.sum(np.abs(dq) > CYCLE_S * robot.max_velocity)
        + np.sum(np.abs(dq - dq_last) > CYCLE_S**2 * robot.max_acceleration)
    )


def track(
    duration_s: float,
    speed_m_s: float = 0.25,
    seed: int = 0,
    delay_cycles: int = 5,
    lag: bool = False,
    gains: FollowerGains | None = None,
    extrapolates: bool = True,
    distance_m: float = 1.2,
) -> Run:
    """Follow the scripted leader from the homes.

    Args:
        delay_cycles: age of what is known of the leader.
        lag: the drives of both lag.
    """
    robot, leader_model = lab().robots["fr"], lab().robots["gr"]
    leader = ScriptedLeader(leader_model, CYCLE_S, speed_m_s, seed)
    follower = CameraFollower(robot, leader_model, CYCLE_S, gains)
    controller = CameraController(follower, leader_model, distance_m, extrapolates=extrapolates)
    q_cmd, q_leader = np.array(robot.home), np.array(leader_model.home)
    servo, leaders_servo, dq = Servo(q_cmd), Servo(q_leader), np.zeros(robot.n)
    first = RobotView(-delay_cycles, -delay_cycles * CYCLE_S, q_leader, q_leader)
    known = deque([first] * (delay_cycles + 1), maxlen=delay_cycles + 1)
    angles, distances, violations = [], [], 0
    for cycle in range(round(duration_s / CYCLE_S)):
        time_s = cycle * CYCLE_S
        q_leader = q_leader + leader.increment(View(RobotView(cycle, time_s, q_leader, q_leader)))
        measured = leaders_servo.follow(q_leader).copy() if lag else q_leader
        known.append(RobotView(cycle, time_s, measured, q_leader))
        q = servo.q if lag else q_cmd
        increment = controller.increment(View(RobotView(cycle, time_s, q, q_cmd), {"gr": known[0]}))
        violations += limit_violations(robot, q_cmd, increment, dq)
        q_cmd, dq = q_cmd + increment, increment
        servo.follow(q_cmd)
        angle, distance = controller.errors(servo.q if lag else q_cmd, measured)
        angles.append(np.rad2deg(angle))
        distances.append(distance)
    return Run(np.array(angles), np.array(distances), violations)


def approach(
    follower: CameraFollower, q: Array, focus: Array, duration_s: float, distance_m: float = 1.2
) -> Run:
    """Turn towards a fixed focus from `q` at rest."""
    controller = CameraController(follower, lab().robots["gr"], distance_m, focus)
    q_leader = lab().robots["gr"].home
    q, dq = q.copy(), np.zeros_like(q)
    angles, distances, violations = [], [], 0
    for cycle in range(round(duration_s / CYCLE_S)):
        angle, distance = controller.errors(q, q_leader)
        angles.append(np.rad2deg(angle))
        distances.append(distance)
        increment = follower.increment(q, dq, focus, None, distance_m, cycle * CYCLE_S)
        violations += limit_violations(follower.robot, q, increment, dq)
        q, dq = q + increment, increment
    return Run(np.array(angles), np.array(distances), violations)
