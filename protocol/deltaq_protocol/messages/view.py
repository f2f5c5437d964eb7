"""The requested view of a camera; the robot's states publish it for the controller that follows with the camera."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.messages.base import Message, Name, Secret

CameraDistance = Annotated[float, Field(ge=0.2, le=4.0, allow_inf_nan=False)]
"""How far a camera may be asked to stand from its target [m]."""
TargetCoordinate = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
TargetPoint = tuple[TargetCoordinate, TargetCoordinate, TargetCoordinate]


MOST_TARGETS = 8
"""Targets that a camera may be given at once."""


class Sight(StrEnum):
    """How well a controller sees what it looks at.

    What it knows of the robot that it follows is as old as the link makes it, older, or gone; or a body is between the
    camera and its target.
    """

    FRESH = "fresh"
    STALE = "view_stale"
    LOST = "view_lost"
    HIDDEN = "view_hidden"


class ViewTarget(Message):
    """One thing to look at: a point of the tool of `leader`, or `focus_m`, a fixed point in the world.

    `aim_offset_m` is that point in the frame of the tool; null is the origin of the frame.
    """

    leader: Name | None = None
    aim_offset_m: TargetPoint | None = None
    focus_m: TargetPoint | None = None

    def words(self) -> str:
        """The target as people read it, and as `deltaq view --target` takes it."""
        if self.focus_m is not None:
            return _coordinates(self.focus_m)
        name = self.leader or ""
        return name if self.aim_offset_m is None else f"{name}:{_coordinates(self.aim_offset_m)}"


class ViewWish(Message):
    """Requested target and distance of a robot's camera; the controller that follows with it reads them in its states.

    The target is `aim_offset_m`, a point in the frame of the tool of `leader`, or `focus_m`, a fixed point in the
    world. A null value leaves the value with which the follower was started. With `targets`, the most important one
    first, the camera looks at the first that it can see, and the three above are null.
    """

    distance_m: CameraDistance | None = None
    leader: Name | None = None
    aim_offset_m: TargetPoint | None = None
    focus_m: TargetPoint | None = None
    targets: Annotated[tuple[ViewTarget, ...], Field(min_length=1, max_length=MOST_TARGETS)] | None = None


class ViewRequest(ViewWish):
    """Ask the controller that follows with a robot's camera for another view; states publish it (`RobotState.view`).

    A null value changes nothing. A `leader` or `aim_offset_m` ends an earlier `focus_m`, each of the three ends earlier
    `targets`, and `targets` end all three. The request needs the right to have a lease, but not the lease itself, which
    the follower holds. `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["view"] = "view"
    robot: Name
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class ViewReply(Message):
    """The view that results from all requests so far, and the holder of the robot: null if no client follows.

    `sight` and `target` are as in the robot's states: what the camera looks at now, and how well it sees it.
    """

    type: Literal["view"] = "view"
    robot: Name
    view: ViewWish
    holder: str | None = None
    sight: Sight | None = None
    target: ViewTarget | None = None


def _coordinates(point: TargetPoint) -> str:
    return ",".join(f"{coordinate:g}" for coordinate in point)
