"""The other robots of a cell as the quadratic programme sees them: where they will be, and how fast."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_controllers.camera.focus import FocusTracker
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView
from deltaq_controllers.spheres import PlacedSpheres
from deltaq_protocol.arrays import Array


class OtherRobots:
    """Estimates of the joints of every robot but the own one; vectors over the cell are in the cell's order.

    Args:
        scene: the cell and who is who in it.
    """

    def __init__(self, scene: Scene) -> None:
        self._robots, self._own, self._leader = scene.cell.robots, scene.robot_name, scene.leader_name
        self._trackers = {name: FocusTracker() for name in self._robots if name != self._own}
        self._bodies = {name: PlacedSpheres(self._robots[name]) for name in self._trackers}

    def update(self, views: Mapping[str, RobotView]) -> None:
        """Add what was measured."""
        for name, view in views.items():
            if name in self._trackers:
                self._trackers[name].update(view.q, view.time_s)

    @property
    def leader(self) -> FocusTracker:
        """The estimate of the leader's joints."""
        return self._trackers[self._leader]

    def ahead(self, time_s: float) -> dict[str, Array]:
        """(m,) joints of each robot that was heard, a time after it was measured [rad or m]."""
        return {name: tracker.ahead(time_s) for name, tracker in self._trackers.items() if tracker.started}

    def spheres_ahead(self, time_s: float) -> tuple[Array, Array]:
        """Centres (k, 3) and radii (k,) of their bounding spheres, a time after they were measured [m]."""
        expected = self.ahead(time_s)
        centres = [self._bodies[name].at(joints) for name, joints in expected.items()]
        return np.concatenate(centres), np.concatenate([self._bodies[name].radii for name in expected])

    def joined(self, q: Array, others: Mapping[str, Array]) -> Array:
        """(m,) joints of all robots of the cell, the own at `q` (n,); a robot that was not heard counts at home."""
        return np.concatenate(
            [q if name == self._own else others.get(name, robot.home) for name, robot in self._robots.items()]
        )

    def rates(self) -> Array:
        """(m,) estimated rates of all joints of the cell, the own ones zero [rad/s or m/s]."""
        return np.concatenate(
            [
                self._trackers[name].velocity
                if name in self._trackers and self._trackers[name].started
                else np.zeros(robot.n)
                for name, robot in self._robots.items()
            ]
        )
