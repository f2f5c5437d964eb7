"""The bodies that hide a target from a camera at its present pose."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_cell.robot_bodies import PointName
from deltaq_cell.sight_lines import SightLines
from deltaq_controllers.camera.scene import focus_of
from deltaq_controllers.interface import View
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import ViewTarget
from deltaq_protocol.messages.motion import AIM_M

# What both eyes of a camera see of a point.


@dataclass(frozen=True)
class Visibility:
    """Visibility of a point for each eye of a camera, left before right; a camera without a baseline has one eye.

    Attributes:
        in_picture: of each eye, whether the point is within its picture.
        blocked_by: of each eye, the bodies on its line of sight, from the eye on; none in which the point lies.
    """

    in_picture: tuple[bool, ...]
    blocked_by: tuple[tuple[str, ...], ...]

    @property
    def eyes_seeing(self) -> int:
        """How many eyes see the point."""
        return sum(
            inside and not bodies for inside, bodies in zip(self.in_picture, self.blocked_by, strict=True)
        )

    @property
    def is_seen(self) -> bool:
        """Whether every eye sees the point."""
        return self.eyes_seeing == len(self.in_picture)


class VisibilityGauge:
    """Computes how much of a target a robot's camera sees, past structure, other robots and the robot itself.

    Args:
        cell: the cell.
        robot: name of the robot, which carries a camera.

    Raises:
        RobotModelError: the robot carries no camera.
    """

    def __init__(self, cell: CellModel, robot: str) -> None:
        self._robot, self._lines = cell.robots[robot], SightLines(cell)
        self._robot.frame_of("camera")
        camera = self._robot.description.camera
        assert camera is not None  # it has the frame
        self._up = math.tan(math.radians(camera.vertical_view_deg) / 2)
        self._aside = camera.aspect * self._up
        half = camera.baseline_m / 2
        # x points up in the picture and z into it: y to the right
        self._eyes_m = (-half, half) if half else (0.0,)

    def look(self, configurations: Mapping[str, Array], target: Array) -> Visibility:
        """The visibility of a point.

        Args:
            configurations: (n,) of each robot of the cell [rad or m]; an omitted robot stays where it was.
            target: (3,) the point in the world [m].
        """
        self._lines.place(configurations)
        T_world_camera = self._robot.camera_pose(configurations[self._robot.name])
        rotation, lens = T_world_camera[:3, :3], T_world_camera[:3, 3]
        eyes = [lens + aside * rotation[:, 1] for aside in self._eyes_m]
        lines = [self._lines.blocked_by(eye, target) for eye in eyes]
        around = self._lines.bodies_at(target) if any(lines) else ()
        return Visibility(
            tuple(self._is_in_picture(rotation.T @ (target - eye)) for eye in eyes),
            tuple(tuple(name for name in line if name not in around) for line in lines),
        )

    def _is_in_picture(self, seen: Array) -> bool:
        """Whether a point (3,) in an eye's axes is within its picture."""
        up, aside, ahead = np.abs(seen[0]), np.abs(seen[1]), seen[2]
        return bool(ahead > 0.0 and up <= self._up * ahead and aside <= self._aside * ahead)


class Outlook:
    """Lines of sight from a robot's camera to targets, in any direction of the camera.

    A target is hidden if bodies, the watched gripper's included, are on the lines of sight of both eyes; see
    `VisibilityGauge`. Bodies that turn with the camera hide nothing: its own housing is between it and targets
    beside it.

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

    def hidden_by(self, view: View, target: ViewTarget) -> tuple[str, ...]:
        """Names of the bodies that hide a target, from the left eye on; empty if an eye sees it.

        Args:
            view: states of the robots; a robot without one stays where it was, at first at home.
            target: the target; `view` has the robot that it names.
        """
        configurations = {name: other.q for name, other in view.others.items()} | {self._robot: view.own.q}
        if target.focus_m is not None:
            focus = np.array(target.focus_m)
        else:
            assert target.leader is not None  # a target is on a tool or fixed
            offset_m = np.array(target.aim_offset_m or AIM_M)
            focus = focus_of(self._robots[target.leader].forward(configurations[target.leader]), offset_m)
        seen = self._gauge.look(configurations, focus)
        blocked = [tuple(name for name in bodies if name not in self._housing) for bodies in seen.blocked_by]
        return blocked[0] if all(blocked) else ()


def moving_with(frame: PointName, robot: RobotModel) -> frozenset[str]:
    """Names of a robot's bodies that move with its tool or camera."""
    joint = robot.model.frames[robot.frame_of(frame)].parentJoint
    return frozenset(body.name for body in robot.geometry.geometryObjects if body.parentJoint == joint)
