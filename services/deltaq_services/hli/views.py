"""What a follower's camera is asked to look at: whether it can be, and all wishes together."""

from __future__ import annotations

from deltaq_cell.description import CellDescription
from deltaq_protocol.messages import ViewRequest, ViewWish


def problem_of(request: ViewRequest, cell: CellDescription) -> tuple[str, str] | None:
    """Why no follower can use this view, and the remedy; None if one can. The robot is one of the cell's."""
    robot = request.robot
    if cell.robots[robot].camera is None:
        having = [name for name, other in cell.robots.items() if other.camera is not None]
        text = f"robot: {robot} carries no camera; {', '.join(having) or 'no robot of the cell'} does"
        return text, f"give it one under `robots.{robot}.camera` in the cell's YAML"
    others = [name for name in cell.robots if name != robot]
    if request.leader is not None and request.leader not in others:
        text = f"leader: {request.leader!r} is no other robot; {robot} can look at {', '.join(others) or 'nobody'}"
        return text, "name another robot of the cell"
    if request.focus_m is not None and (request.leader is not None or request.aim_offset_m is not None):
        text = "focus_m: a point that stands still is not on a tool; leader or aim_offset_m was given too"
        return text, "give one of them"
    return None


def changed(before: ViewWish | None, request: ViewRequest) -> ViewWish:
    """All wishes together: what a request leaves out stays, but that a tool and a fixed point exclude each other."""
    given = {name: value for name in ViewWish.model_fields if (value := getattr(request, name)) is not None}
    if "leader" in given or "aim_offset_m" in given:
        given["focus_m"] = None
    return (before or ViewWish()).model_copy(update=given)
