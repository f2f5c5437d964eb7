"""Camera controllers by name: the paper's law and its variants, the quadratic programme, and your own.

All of them answer a `View` with an increment, and let their focus and view distance be set.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from deltaq_controllers.camera.clear_view import ClearViewFollower
from deltaq_controllers.camera.controller import CameraController
from deltaq_controllers.camera.escape.follower import EscapingFollower
from deltaq_controllers.camera.follower import CameraFollower
from deltaq_controllers.camera.gains import BY_NAME
from deltaq_controllers.camera.qp_follower import QpFollower
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import Controller, ControllerError
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array


class FocusController(Controller, Protocol):
    """A controller that points a camera.

    Attributes:
        desired_distance_m: desired view distance; may be changed at any time [m].
        evades_below_m: clearance below which it evades [m].
    """

    desired_distance_m: float
    evades_below_m: float

    def errors(self, q: Array, q_leader: Array) -> tuple[float, float]:
        """View angle error [rad] and view distance less the desired one [m]."""
        ...

    def clearance(self, q: Array, q_leader: Array) -> float:
        """Least distance between the bodies that the controller keeps apart, as it measures it [m]."""
        ...


@runtime_checkable
class Aiming(Protocol):
    """A controller whose target may be changed at any time; all controllers of this project are such.

    Attributes:
        focus: (3,) fixed point in the world to look at; None for the leader's tool [m].
        aim_offset_m: (3,) point of the leader's tool to look at, in the tool's frame [m].
    """

    focus: Array | None
    aim_offset_m: Array


@runtime_checkable
class Seeing(Protocol):
    """A controller that reports how it sees the leader; all that come with the project do.

    Attributes:
        leader_seen: how the leader is seen, and how old its state is.
    """

    @property
    def leader_seen(self) -> Foreseen:
        """How the leader is seen."""
        ...


Maker = Callable[[Scene, float, Array | None], FocusController]
"""Makes a controller for a scene, a desired view distance [m] and a fixed focus (3,), None for the leader's tool."""

NAMES = (*BY_NAME, "qp", "clear-view", "escape")
"""The controllers that come with the project."""


def camera_controller_named(
    name: str, scene: Scene, distance_m: float, focus: Array | None = None
) -> FocusController:
    """A camera controller by its name.

    Args:
        name: one of `NAMES`, or `package.module:function` of a `Maker`.
        scene: the scene that it is for.
        distance_m: desired view distance [m].
        focus: (3,) fixed point to look at in place of the leader's tool [m].

    Raises:
        ControllerError: there is no controller of that name.
    """
    if name in BY_NAME:
        follower = CameraFollower(scene.robot, scene.leader, scene.cycle_s, variants=BY_NAME[name])
        return CameraController(follower, scene.leader, distance_m, focus, scene.aim_offset_m)
    if name == "qp":
        return QpFollower(scene, distance_m, focus)
    if name == "clear-view":
        return ClearViewFollower(scene, distance_m, focus)
    if name == "escape":
        return EscapingFollower(scene, distance_m, focus)
    return _imported(name)(scene, distance_m, focus)


def _imported(name: str) -> Maker:
    module, colon, attribute = name.partition(":")
    if not colon:
        raise ControllerError(
            f"no controller {name!r}; there are {', '.join(NAMES)}, and package.module:function for one's own"
        )
    try:
        maker: Maker = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ControllerError(f"controller {name!r} cannot be imported: {error}") from None
    return maker
