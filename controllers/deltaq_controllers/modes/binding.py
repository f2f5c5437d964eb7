"""Which constraint of a solved programme keeps the pace below what is commanded."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.increment_bounds import POSITION, SPEED, Box
from deltaq_controllers.modes.interface import Instant
from deltaq_controllers.modes.limitation import Limitation, of_joint, of_pair, of_speed
from deltaq_controllers.modes.programme import Solution
from deltaq_controllers.surroundings.surroundings import Near

_PRESSES = 1e-9
"""Force of a constraint below which it does not bind."""


def binding(robot: RobotModel, instant: Instant, found: Solution, box: Box, near: Near) -> Limitation | None:
    """The constraint that presses hardest, in words; None for acceleration, which passes.

    Args:
        robot: the robot.
        instant: what the programme was made for.
        found: its solution.
        box: the bounds of the joints in it.
        near: the barriers in it.
    """
    if len(found.barrier_forces) and found.barrier_forces.max() > max(
        _PRESSES, np.abs(found.joint_forces).max()
    ):
        assert instant.surroundings is not None  # they have barriers
        place = int(near.barriers.places[np.argmax(found.barrier_forces)])
        pair, kept_m = instant.surroundings.kept(int(near.pairs.pairs[place]))
        return of_pair(pair, float(near.pairs.distance[place]), kept_m)
    names = robot.joint_names
    for joint in np.argsort(-np.abs(found.joint_forces)).tolist():
        force = found.joint_forces[joint]
        if abs(force) < _PRESSES:
            return None
        why = (box.why_fastest if force > 0.0 else box.why_slowest)[joint]
        if why == SPEED:
            return of_speed(names[joint])
        if why == POSITION:
            return of_joint(names[joint], float(instant.q_cmd[joint]), bool(robot.revolute[joint]))
    return None
