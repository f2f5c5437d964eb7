"""What a camera controller knows of its cell before it starts."""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel


@dataclass(frozen=True)
class Scene:
    """The cell of a camera controller, and the roles of its robots.

    Attributes:
        cell: the cell; a client builds it from the description that the HLI gives it.
        robot_name: the robot that carries the camera.
        leader_name: the robot that is watched.
    """

    cell: CellModel
    robot_name: str
    leader_name: str

    @property
    def robot(self) -> RobotModel:
        """The robot that carries the camera."""
        return self.cell.robots[self.robot_name]

    @property
    def leader(self) -> RobotModel:
        """The robot that is watched."""
        return self.cell.robots[self.leader_name]

    @property
    def cycle_s(self) -> float:
        """Cycle of the robots [s]."""
        return self.cell.description.cycle_s
