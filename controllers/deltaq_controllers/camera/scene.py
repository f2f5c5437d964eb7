"""The cell of a camera controller, and the roles of its robots."""

from dataclasses import dataclass

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages.motion import AIM_M

# The target of a camera: a point of the leader's tool, or a fixed point.


def focus_of(T_world_tool: Array, aim_offset_m: Array) -> Array:
    """(3,) a point of a tool in the world [m].

    Args:
        T_world_tool: (4, 4) pose of the tool.
        aim_offset_m: (3,) the point in the tool's frame [m].
    """
    focus: Array = T_world_tool[:3, 3] + T_world_tool[:3, :3] @ np.asarray(aim_offset_m, dtype=np.float64)
    return focus


@dataclass(frozen=True)
class Scene:
    """The cell of a camera controller, and the roles of its robots.

    Attributes:
        cell: the cell; a client builds it from the description that the HLI gives it.
        robot_name: the robot that carries the camera.
        leader_name: the robot that is watched.
        aim_offset_m: watched point of the leader's tool, in the tool's frame [m]: a gripper works in front of its
            fingers, and the fingers hide the space between them.
    """

    cell: CellModel
    robot_name: str
    leader_name: str
    aim_offset_m: tuple[float, float, float] = AIM_M

    @property
    def robot(self) -> RobotModel:
        """The robot that carries the camera."""
        return self.cell.robots[self.robot_name]

    @property
    def leader(self) -> RobotModel:
        """The leader: the robot that the camera watches."""
        return self.cell.robots[self.leader_name]

    def focus_at(self, q_leader: Array) -> Array:
        """(3,) the focus in the world, for a configuration of the leader [m]."""
        return focus_of(self.leader.forward(q_leader), np.array(self.aim_offset_m))

    @property
    def cycle_s(self) -> float:
        """Cycle of the robots [s]."""
        return self.cell.description.cycle_s
