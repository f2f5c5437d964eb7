"""The target of an attacker, estimated from the motion of its tool."""

from __future__ import annotations

import numpy as np

from deltaq_controllers.camera.escape.rollout import ATTACKERS_M_S2, LENS, NOTHING, Attacker
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.spheres import PlacedSpheres, Spheres
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array

_OUTER_JOINTS = 6
"""Bodies on joints before the last six, as on a gantry, are assumed to come near no robot."""

_SMOOTHS = 0.02
"""Fraction of a new error in the smoothed one, per cycle."""
_FOLLOWS = 0.15
"""Fraction of its error that an expected velocity makes good in a cycle."""
_MOVES_M_S = 0.08
"""Least speed at which a tool is taken to have a target [m/s]."""
_EXPLAINS = 0.22
"""Greatest error of the velocity that a target leads to expect, as a fraction of the greatest speed."""
_STAYS = 0.8
"""Factor of the error of the present target, so that two that are as likely do not alternate."""
_FORGETS = 0.9995
"""Fraction of the greatest speed seen that is still expected a cycle later."""
_LEAST_M_S = 0.05


class Pursuit:
    """The leader as an attacker.

    For each point that its tool may attack, the velocity of a tool that homes in on it is predicted from cycle to
    cycle. The target is the point with the least recent prediction error; there is none if all errors are large. The
    direction of the velocity alone is not enough: a tool that an arm has evaded still turns.

    Args:
        scene: the cell and the roles of its robots.
    """

    def __init__(self, scene: Scene) -> None:
        leader = scene.leader
        self._spheres = PlacedSpheres(leader)
        self._outer = Spheres.of(leader).joints > leader.n - _OUTER_JOINTS
        self._tool = Kinematics(leader, "tool")
        points = 1 + scene.robot.n  # the lens comes first, then the joints
        self._expected, self._errors = np.zeros((points, 3)), np.zeros(points)
        self._speed, self._target, self._cycle_s = _LEAST_M_S, NOTHING, scene.cycle_s

    def update(self, leader: Foreseen, joints: Array, lens: Array) -> Attacker:
        """The attacker with its present target.

        Args:
            leader: how it is seen.
            joints: (n, 3) origins of the own joints, which it may be after [m].
            lens: (3,) which it may be after too [m].
        """
        q = leader.ahead()
        self._tool.update(q)
        tip = self._tool.position
        velocity = self._tool.at_point(tip) @ leader.velocity
        self._speed = max(float(np.linalg.norm(velocity)), _FORGETS * self._speed, _LEAST_M_S)
        self._target = self._aims_at(tip, velocity, np.vstack([lens, joints]))
        centres, radii = self._spheres.at(q)[self._outer], self._spheres.radii[self._outer]
        return Attacker(centres, radii, tip, velocity, self._speed, self._target)

    def _aims_at(self, tip: Array, velocity: Array, points: Array) -> int:
        ways = points - tip
        far = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
        toward = np.minimum(self._speed, np.sqrt(2.0 * ATTACKERS_M_S2 * far)) / far
        change = toward[:, None] * ways - self._expected
        size = np.maximum(np.linalg.norm(change, axis=1), 1e-9)
        self._expected += np.minimum(ATTACKERS_M_S2 * self._cycle_s / size, 1.0)[:, None] * change
        error = velocity - self._expected
        self._expected += _FOLLOWS * error
        self._errors += _SMOOTHS * (np.linalg.norm(error, axis=1) - self._errors)
        if self._speed < _MOVES_M_S:
            return NOTHING
        errors = self._errors.copy()
        if self._target != NOTHING:
            errors[self._target - LENS] *= _STAYS
        best = int(np.argmin(errors))
        return LENS + best if errors[best] < _EXPLAINS * self._speed else NOTHING
