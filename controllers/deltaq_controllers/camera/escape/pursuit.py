"""The target of an attacker, estimated from the motion of its tool."""

from __future__ import annotations

import numpy as np

from deltaq_controllers.camera.escape.rollout import LENS, NOTHING, Attacker
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.spheres import PlacedSpheres, Spheres
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array

_OUTER_JOINTS = 6
"""Bodies on joints before the last six, as on a gantry, are assumed to come near no robot."""

_SMOOTHS = 0.1
"""Fraction of a new velocity in the smoothed one, per cycle."""
_MOVES_M_S = 0.08
"""Least speed at which a tool is taken to have a target [m/s]."""
_HEADS = 0.8
"""Least cosine of the angle between a tool's velocity and the direction to its target."""
_STAYS = 0.02
"""By how much another target's cosine has to exceed that of the present target."""
_FORGETS = 0.9995
"""Fraction of the greatest speed seen that is still expected a cycle later."""
_LEAST_M_S = 0.05


class Pursuit:
    """The leader as an attacker.

    Args:
        scene: the cell and the roles of its robots.
    """

    def __init__(self, scene: Scene) -> None:
        leader = scene.leader
        self._spheres = PlacedSpheres(leader)
        self._outer = Spheres.of(leader).joints > leader.n - _OUTER_JOINTS
        self._tool = Kinematics(leader, "tool")
        self._smoothed, self._speed, self._target = np.zeros(3), _LEAST_M_S, NOTHING

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
        self._smoothed = (1.0 - _SMOOTHS) * self._smoothed + _SMOOTHS * velocity
        self._speed = max(float(np.linalg.norm(velocity)), _FORGETS * self._speed, _LEAST_M_S)
        self._target = self._aims_at(tip, np.vstack([lens, joints]))
        centres, radii = self._spheres.at(q)[self._outer], self._spheres.radii[self._outer]
        return Attacker(centres, radii, tip, velocity, self._speed, self._target)

    def _aims_at(self, tip: Array, points: Array) -> int:
        speed = float(np.linalg.norm(self._smoothed))
        if speed < _MOVES_M_S:
            return NOTHING
        ways = points - tip
        cosines = ways @ self._smoothed / np.maximum(speed * np.linalg.norm(ways, axis=1), 1e-9)
        # the lens comes first, then the joints
        if self._target != NOTHING:
            cosines[self._target - LENS] += _STAYS
        best = int(np.argmax(cosines))
        return LENS + best if cosines[best] > _HEADS else NOTHING
