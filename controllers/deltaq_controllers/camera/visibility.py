"""Whether a camera sees its target: within the pictures of both eyes, and with no body on the lines of sight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.sight_lines import SightLines
from deltaq_protocol.arrays import Array


@dataclass(frozen=True)
class Visibility:
    """What the eyes of a camera see of a point, left before right; a camera without a baseline has one eye.

    Attributes:
        in_picture: of each eye, whether the point is within its picture.
        blocked_by: of each eye, the bodies on its line of sight, from the eye on.
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
    """Computes what a robot's camera sees among the bodies of its cell: structure, other robots and the robot itself.

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
        """What the camera sees of a point.

        Args:
            configurations: (n,) of each robot of the cell [rad or m]; an omitted robot stays where it was.
            target: (3,) the point in the world [m].
        """
        self._lines.place(configurations)
        T_world_camera = self._robot.camera_pose(configurations[self._robot.name])
        rotation, lens = T_world_camera[:3, :3], T_world_camera[:3, 3]
        eyes = [lens + aside * rotation[:, 1] for aside in self._eyes_m]
        return Visibility(
            tuple(self._is_in_picture(rotation.T @ (target - eye)) for eye in eyes),
            tuple(self._lines.blocked_by(eye, target) for eye in eyes),
        )

    def bodies_at(self, point: Array) -> tuple[str, ...]:
        """Names of the bodies at a point (3,) in the world [m], with robots where they were looked at last."""
        return self._lines.bodies_at(point)

    def _is_in_picture(self, seen: Array) -> bool:
        """Whether a point (3,) in an eye's axes is within its picture."""
        up, aside, ahead = np.abs(seen[0]), np.abs(seen[1]), seen[2]
        return bool(ahead > 0.0 and up <= self._up * ahead and aside <= self._aside * ahead)
