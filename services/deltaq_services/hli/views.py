"""What a follower's camera is asked to look at: whether it can be, and all wishes together."""

from __future__ import annotations

from collections.abc import Sequence

from deltaq_cell.description import CellDescription
from deltaq_protocol.messages import ViewRequest, ViewTarget, ViewWish

_NOT_ON_A_TOOL = "focus_m: a point that stands still is not on a tool; leader or aim_offset_m was given too"
_EACH = "give each target either a `leader`, which may have an `aim_offset_m`, or a `focus_m`"


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
        return _NOT_ON_A_TOOL, "give one of them"
    if request.targets is None:
        return None
    if any(value is not None for value in (request.leader, request.aim_offset_m, request.focus_m)):
        text = "targets: they are all that is looked at; leader, aim_offset_m or focus_m was given too"
        return text, "make it one of the targets"
    for place, target in enumerate(request.targets):
        text = _problem_of_target(target, others)
        if text:
            return f"targets.{place}.{text}", _EACH
    return None


def _problem_of_target(target: ViewTarget, others: Sequence[str]) -> str:
    """Why nobody can look at it; empty if one can."""
    if target.leader is not None and target.leader not in others:
        return f"leader: {target.leader!r} is no other robot; there are {', '.join(others) or 'none'}"
    if target.focus_m is None:
        return "" if target.leader is not None else "leader: missing, and so is focus_m"
    if target.leader is not None or target.aim_offset_m is not None:
        return _NOT_ON_A_TOOL
    return ""


def changed(before: ViewWish | None, request: ViewRequest) -> ViewWish:
    """All wishes together: what a request leaves out stays, but that a new target ends those of another kind."""
    given = {name: value for name in ViewWish.model_fields if (value := getattr(request, name)) is not None}
    ended: set[str] = set()
    if "targets" in given:
        ended |= {"leader", "aim_offset_m", "focus_m"}
    if given.keys() & {"leader", "aim_offset_m"}:
        ended |= {"focus_m", "targets"}
    if "focus_m" in given:
        ended.add("targets")
    return (before or ViewWish()).model_copy(update={**dict.fromkeys(ended), **given})
