"""What hides a target from a camera where it is now, for the choice among targets and for people."""

from __future__ import annotations

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_cell.robot_bodies import PointName
from deltaq_controllers.camera.aim import TOOL, focus_of
from deltaq_controllers.camera.visibility import VisibilityGauge
from deltaq_controllers.interface import View
from deltaq_protocol.messages import ViewTarget


class Outlook:
    """Lines of sight from a robot's camera to targets, whether or not the camera is turned to them.

    A target is part of something: whatever moves with the tool that is looked at does not hide it, nor does a body in
    which a fixed point lies. What turns with the camera hides nothing either: its own housing is between it and what
    is beside it. One eye that sees the target is enough.

    Args:
        cell: the cell.
        robot: name of the robot, which carries a camera.

    Raises:
        RobotModelError: the robot carries no camera.
    """

    def __init__(self, cell: CellModel, robot: str) -> None:
        self._gauge = VisibilityGauge(cell, robot)
        self._robot, self._robots = robot, cell.robots
        self._housing = moving_with("camera", cell.robots[robot])
        self._hands = {
            name: moving_with("tool", other) for name, other in cell.robots.items() if name != robot
        }

    def hidden_by(self, view: View, target: ViewTarget) -> tuple[str, ...]:
        """Names of the bodies that hide a target, from the left eye on; empty if an eye sees it.

        Args:
            view: where the robots are; one that is not in it stays where it was, at first at home.
            target: what to look for; the robot that it names is in the view.
        """
        configurations = {name: other.q for name, other in view.others.items()} | {self._robot: view.own.q}
        if target.focus_m is not None:
            focus = np.array(target.focus_m)
            parts = frozenset(self._gauge.bodies_at(focus))
        else:
            assert target.leader is not None  # a target is on a tool or fixed
            offset_m = np.array(target.aim_offset_m or TOOL)
            focus = focus_of(self._robots[target.leader].forward(configurations[target.leader]), offset_m)
            parts = self._hands[target.leader]
        seen = self._gauge.look(configurations, focus)
        parts |= self._housing
        blocked = [tuple(name for name in bodies if name not in parts) for bodies in seen.blocked_by]
        return blocked[0] if all(blocked) else ()


def moving_with(frame: PointName, robot: RobotModel) -> frozenset[str]:
    """Names of a robot's bodies that move with its tool or camera."""
    joint = robot.model.frames[robot.frame_of(frame)].parentJoint
    return frozenset(body.name for body in robot.geometry.geometryObjects if body.parentJoint == joint)
