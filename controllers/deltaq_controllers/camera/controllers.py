"""Camera controllers by name: the paper's law, the quadratic programme, and your own.

All of them answer a `View` with an increment, and let their focus and view distance be set.
"""

import importlib
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.clear_view import ClearViewFollower
from deltaq_controllers.camera.error import view_angle
from deltaq_controllers.camera.escape.follower import EscapingFollower
from deltaq_controllers.camera.follower import CameraFollower
from deltaq_controllers.camera.qp_follower import QpFollower
from deltaq_controllers.camera.scene import Scene, focus_of
from deltaq_controllers.camera.standing_barriers import StandingBarriers
from deltaq_controllers.interface import Controller, ControllerError, LastIncrement, View
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages.motion import AIM_M

# The camera follower as a controller: its focus and its obstacles come from the view.


class CameraController:
    """Looks at the leader's tool, or at a fixed point, from a desired distance.

    Until the first state of the leader the robot is brought to rest.

    Args:
        follower: the follower.
        leader: model of the leader.
        desired_distance_m: desired view distance; may be changed at any time [m].
        focus: (3,) fixed point in the world to look at in place of the leader's tool [m].
        aim_offset_m: (3,) point of the leader's tool to look at, in the tool's frame [m].
        extrapolates: whether the focus is the leader's predicted position, not the measured one.
        barriers: of the robot's own bodies and of the structure; None for the published law alone.

    Attributes:
        follower, desired_distance_m, focus, aim_offset_m: as given; all but the first may be changed at any time.
        leader_seen: how the leader is seen, and how old its state is.
        evades_below_m: clearance below which the repulsion (12) acts [m].
    """

    def __init__(
        self,
        follower: CameraFollower,
        leader: RobotModel,
        desired_distance_m: float,
        focus: Array | None = None,
        aim_offset_m: tuple[float, float, float] = AIM_M,
        *,
        extrapolates: bool = True,
        barriers: StandingBarriers | None = None,
    ) -> None:
        self.follower = follower
        self.desired_distance_m = desired_distance_m
        self.focus = focus
        self.aim_offset_m: Array = np.array(aim_offset_m)
        self.evades_below_m = follower.gains.repulsion_range_m
        self._leader, self._extrapolates, self._barriers = leader, extrapolates, barriers
        self._last = LastIncrement(follower.limits.max_ddq)
        self.leader_seen = Foreseen(leader, follower.robot, follower.cycle_s)

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        own, leader = view.own, view.others.get(self._leader.name)
        dq_last = self._last.update(own)
        if leader is None:
            return self.follower.limits.admissible(np.zeros_like(own.q_cmd), own.q_cmd, dq_last)
        self.leader_seen.update(own, leader)
        q_leader = self.leader_seen.ahead() if self._extrapolates else leader.q
        focus = self.focus_at(q_leader)
        dq = self.follower.increment(
            own.q_cmd, dq_last, focus, q_leader, self.desired_distance_m, leader.time_s
        )
        if self._barriers is None:
            return dq
        kept = self._barriers.increment(dq, own.q_cmd, dq_last, focus, self.desired_distance_m)
        return dq if kept is dq else self.follower.limits.admissible(kept, own.q_cmd, dq_last)

    @property
    def bounds_met(self) -> tuple[str, ...]:
        """The bounds that held the last increment back, for people; see `Bounded`."""
        return () if self._barriers is None else self._barriers.bounds_met

    def focus_at(self, q_leader: Array) -> Array:
        """(3,) the focus in the world for a configuration of the leader [m]."""
        if self.focus is not None:
            return self.focus
        return focus_of(self._leader.forward(q_leader), self.aim_offset_m)

    def clearance(self, q: Array, q_leader: Array) -> float:
        """Least clearance of bounding spheres from the leader's [m]."""
        return self.follower.clearance_at(q, q_leader)

    def errors(self, q: Array, q_leader: Array) -> tuple[float, float]:
        """View angle error [rad] and view distance less the desired one [m], at measured configurations."""
        T_world_camera = self.follower.robot.camera_pose(q)
        focus, lens = self.focus_at(q_leader), T_world_camera[:3, 3]
        distance = float(np.linalg.norm(focus - lens))
        return view_angle(T_world_camera[:3, :3], lens, focus), distance - self.desired_distance_m


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


@runtime_checkable
class Bounded(Protocol):
    """A controller that reports what holds its arm back; all that come with the project do."""

    @property
    def bounds_met(self) -> tuple[str, ...]:
        """Joints at a limit, and pairs of bodies that leave the last increment no room, for people."""
        ...


Maker = Callable[[Scene, float, Array | None], FocusController]
"""Makes a controller for a scene, a desired view distance [m] and a fixed focus (3,), None for the leader's tool."""

NAMES = ("paper", "predictive", "qp", "clear-view", "escape")
"""The controllers that come with the project. `paper` is the paper's law with its errata corrected; `predictive` also
extrapolates the focus, which the paper leaves to future work (VII-B)."""


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
    if name in ("paper", "predictive"):
        follower, ahead = CameraFollower(scene.robot, scene.leader, scene.cycle_s), name == "predictive"
        barriers = StandingBarriers(scene, follower.limits)
        return CameraController(
            follower,
            scene.leader,
            distance_m,
            focus,
            scene.aim_offset_m,
            extrapolates=ahead,
            barriers=barriers,
        )
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
            f"no controller {name!r}; there are {', '.join(NAMES)}, or package.module:function for your own"
        )
    try:
        maker: Maker = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ControllerError(f"controller {name!r} cannot be imported: {error}") from None
    return maker
