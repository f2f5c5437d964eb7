"""A camera whose view follows the requests in its robot's states: distance, target, and the robot that it watches.

For each robot that can be watched there is a controller, made before anything moves: another leader costs no cycle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_controllers.camera.controllers import Aiming, FocusController, Seeing
from deltaq_controllers.interface import View
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import ViewWish

LEARNING_CYCLES = 3
"""Cycles that a controller observes before it takes over, to learn how fast the robots move."""


class CameraInUse:
    """Camera controllers, one for each robot that can be watched, of which one is in use.

    Args:
        cameras: the controllers by their leaders.
        leader: the robot that is watched first.

    Attributes:
        leader: the robot that is watched.
        evades_below_m: of the controller in use [m].
    """

    def __init__(self, cameras: Mapping[str, FocusController], leader: str) -> None:
        self._cameras, self.leader = dict(cameras), leader
        self._next, self._learnt_cycles = leader, 0
        self._wish: ViewWish | None = None
        self.evades_below_m = self._camera.evades_below_m

    def take(self, wish: ViewWish | None) -> None:
        """Use a requested view from now on; a request that was taken before changes nothing."""
        if wish is None or wish == self._wish:
            return
        self._wish = wish
        for camera in self._cameras.values():
            _aim(camera, wish)
        if wish.leader in self._cameras and wish.leader != self._next:
            self._next, self._learnt_cycles = wish.leader, 0

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        if self._next != self.leader:
            if self._learnt_cycles == LEARNING_CYCLES:
                self.leader = self._next
                self.evades_below_m = self._camera.evades_below_m
            else:
                self._cameras[self._next].increment(view)
                self._learnt_cycles += 1
        return self._camera.increment(view)

    @property
    def desired_distance_m(self) -> float:
        """Desired view distance [m]."""
        return self._camera.desired_distance_m

    @desired_distance_m.setter
    def desired_distance_m(self, distance_m: float) -> None:
        for camera in self._cameras.values():
            camera.desired_distance_m = distance_m

    @property
    def leader_seen(self) -> Foreseen | None:
        """How the leader is seen; None if the controller does not report it."""
        return self._camera.leader_seen if isinstance(self._camera, Seeing) else None

    def errors(self, q: Array, q_leader: Array) -> tuple[float, float]:
        """View angle error [rad] and view distance less the desired one [m]."""
        return self._camera.errors(q, q_leader)

    def clearance(self, q: Array, q_leader: Array) -> float:
        """Least distance between the bodies that the controller keeps apart [m]."""
        return self._camera.clearance(q, q_leader)

    @property
    def _camera(self) -> FocusController:
        return self._cameras[self.leader]


def _aim(camera: FocusController, wish: ViewWish) -> None:
    if wish.distance_m is not None:
        camera.desired_distance_m = wish.distance_m
    if not isinstance(camera, Aiming):
        return
    if wish.focus_m is not None:
        camera.focus = np.array(wish.focus_m)
    elif wish.leader is not None or wish.aim_offset_m is not None:
        camera.focus = None
    if wish.aim_offset_m is not None:
        camera.aim_offset_m = np.array(wish.aim_offset_m)
