"""What the camera follower is to do, as numbers: look at the leader's tool, from the desired distance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deltaq_controllers.camera.error import view_angle
from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.scene import VIEW_DISTANCE_M
from deltaq_protocol.arrays import Array


class ViewErrors(NamedTuple):
    """What a view lacks.

    Attributes:
        angle_rad: between the camera's axis and the direction of the focus [rad].
        distance_m: view distance less the desired one [m].
    """

    angle_rad: float
    distance_m: float

    @property
    def reward(self) -> float:
        """Zero for a perfect view, else negative: a radian counts as much as a metre."""
        return -self.angle_rad - abs(self.distance_m)


class CameraTask:
    """Measures views as the experiments do.

    Args:
        scene: who watches whom.

    Attributes:
        desired_distance_m: desired view distance [m].
    """

    desired_distance_m = VIEW_DISTANCE_M

    def __init__(self, scene: Scene) -> None:
        self._robot, self._leader = scene.robot, scene.leader

    def errors(self, q: Array, q_leader: Array) -> ViewErrors:
        """The errors at measured configurations (n,) of both robots [rad or m]."""
        T_world_camera = self._robot.camera_pose(q)
        lens, focus = T_world_camera[:3, 3], self._leader.forward(q_leader)[:3, 3]
        distance_m = float(np.linalg.norm(focus - lens))
        return ViewErrors(
            view_angle(T_world_camera[:3, :3], lens, focus), distance_m - self.desired_distance_m
        )
