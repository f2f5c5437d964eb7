"""Which constraint of a solved programme keeps the pace below what is commanded."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.interface import Instant
from deltaq_controllers.modes.limitation import Limitation, of_joint, of_pair, of_speed
from deltaq_controllers.modes.programme import Joints, Solution
from deltaq_controllers.surroundings.surroundings import Near
from deltaq_protocol.brake import brake_cycles

_PRESSES = 1e-9
"""Force of a constraint below which it does not bind."""

_AT_SPEED = 1.0 - 1e-9
"""Fraction of the greatest increment from which on a bound is one of speed."""


def binding(
    robot: RobotModel, instant: Instant, found: Solution, joints: Joints, near: Near
) -> Limitation | None:
    """The constraint that presses hardest, in words; None for acceleration, which passes.

    Args:
        robot: the robot.
        instant: what the programme was made for.
        found: its solution.
        joints: the bounds of the joints in it.
        near: the barriers in it.
    """
    if len(found.barrier_forces) and found.barrier_forces.max() > max(
        _PRESSES, np.abs(found.joint_forces).max()
    ):
        assert instant.surroundings is not None  # they have barriers
        place = int(np.argmax(found.barrier_forces))
        pair, kept_m = instant.surroundings.kept(int(near.pairs[place]))
        return of_pair(pair, float(near.distances[place]), kept_m)
    limits, names = instant.limits, robot.joint_names
    for joint in np.argsort(-np.abs(found.joint_forces)).tolist():
        force = found.joint_forces[joint]
        if abs(force) < _PRESSES:
            return None
        bound = joints.fastest[joint] if force > 0.0 else joints.slowest[joint]
        if abs(bound) >= _AT_SPEED * limits.max_dq[joint]:
            return of_speed(names[joint])
        room = (limits.upper if force > 0.0 else limits.lower)[joint] - instant.q_cmd[joint]
        brake = 0.5 * (brake_cycles(instant.dq_last, limits.max_ddq) + 4)
        if bound * brake * np.sign(force) >= _AT_LIMIT * room * np.sign(force) - _ROUNDING:
            return of_joint(names[joint], float(instant.q_cmd[joint]), bool(robot.revolute[joint]))
    return None


_AT_LIMIT = 1.0 - 1e-6
_ROUNDING = 1e-12
