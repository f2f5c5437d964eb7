"""The requested view of a camera; the robot's states publish it for the controller that follows with the camera."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.messages.base import Message, Name, Secret

CameraDistance = Annotated[float, Field(ge=0.2, le=4.0, allow_inf_nan=False)]
"""How far a camera may be asked to stand from its target [m]."""
TargetCoordinate = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
TargetPoint = tuple[TargetCoordinate, TargetCoordinate, TargetCoordinate]


class ViewWish(Message):
    """Requested target and distance of a robot's camera; the controller that follows with it reads them in its states.

    The target is `aim_offset_m`, a point in the frame of the tool of `leader`, or `focus_m`, a fixed point in the
    world. A null value leaves the value with which the follower was started.
    """

    distance_m: CameraDistance | None = None
    leader: Name | None = None
    aim_offset_m: TargetPoint | None = None
    focus_m: TargetPoint | None = None


class ViewRequest(ViewWish):
    """Ask the controller that follows with a robot's camera for another view; states publish it (`RobotState.view`).

    A null value changes nothing. A `leader` or `aim_offset_m` ends an earlier `focus_m`. The request needs the right to
    have a lease, but not the lease itself, which the follower holds. `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["view"] = "view"
    robot: Name
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class ViewReply(Message):
    """The view that results from all requests so far, and the holder of the robot: null if no client follows."""

    type: Literal["view"] = "view"
    robot: Name
    view: ViewWish
    holder: str | None = None
