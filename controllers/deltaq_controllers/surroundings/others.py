"""The other robots of a cell as the controller of one sees them: where their setpoints will be, and how fast."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.interface import View
from deltaq_controllers.spheres import PlacedSpheres
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array


class OtherRobots:
    """Setpoints of every robot but the own one; vectors over the cell are in the cell's order.

    Args:
        cell: the cell.
        robot: name of the own one.
    """

    def __init__(self, cell: CellModel, robot: str) -> None:
        self._robots, self._own = cell.robots, robot
        own, cycle_s = cell.robots[robot], cell.description.cycle_s
        self._others = {
            name: Foreseen(robot, own, cycle_s) for name, robot in self._robots.items() if name != self._own
        }
        self._bodies = {name: PlacedSpheres(self._robots[name]) for name in self._others}

    def update(self, view: View) -> None:
        """Add what was seen."""
        for name, other in view.others.items():
            if name in self._others:
                self._others[name].update(view.own, other)

    def named(self, name: str) -> Foreseen:
        """One of them."""
        return self._others[name]

    def ahead(self, time_s: float = 0.0) -> dict[str, Array]:
        """(m,) setpoint of each robot that was heard, a time after the own robot's next increment [rad or m]."""
        return {name: other.ahead(time_s) for name, other in self._others.items() if other.setpoints.started}

    def spheres_ahead(self, time_s: float) -> tuple[Array, Array]:
        """Centres (k, 3) and radii (k,) of their bounding spheres, a time after the next increment [m]."""
        expected = self.ahead(time_s)
        centres = [self._bodies[name].at(joints) for name, joints in expected.items()]
        return np.concatenate(centres), np.concatenate([self._bodies[name].radii for name in expected])

    def joined(self, q: Array, others: Mapping[str, Array]) -> Array:
        """(m,) joints of all robots of the cell, the own at `q` (n,); a robot that was not heard counts at home."""
        return np.concatenate(
            [q if name == self._own else others.get(name, robot.home) for name, robot in self._robots.items()]
        )

    def rates(self) -> Array:
        """(m,) rates of all joints of the cell, the own ones zero [rad/s or m/s]."""
        return np.concatenate(
            [
                self._others[name].velocity
                if name in self._others and self._others[name].setpoints.started
                else np.zeros(robot.n)
                for name, robot in self._robots.items()
            ]
        )
