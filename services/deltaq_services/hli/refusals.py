"""Refusals: the answers to increments that are no valid requests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from deltaq_cell.description import RobotDescription
from deltaq_protocol import topics
from deltaq_protocol.messages import MOST, MOST_OF_A_JOINT, Outcome, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.outputs import Output, Sender, ToSender, ToTopic

_LONGEST_NAME = 64


def refusal(
    robot: str,
    cycle: int,
    seq: int,
    reason: Reason,
    sender: Sender | None,
    is_holders: bool,
    outcome: Outcome = Outcome.REFUSED,
) -> list[Output]:
    """Send the HLI's verdict on an increment to the sender; on the holder's, to every watcher too.

    A sender over zenoh reads the open verdict: a zenoh sample does not say where it came from. It holds the lease, or
    has just lost it.
    """
    verdict = Verdict(robot=robot, cycle=cycle, seq=seq, outcome=outcome, reasons=(reason,))
    outputs: list[Output] = [] if sender is None else [ToSender(sender, verdict)]
    if is_holders or sender is None:
        outputs.append(ToTopic(topics.VERDICT, robot, verdict))
    return outputs


def answered_by_error(data: Mapping[str, object]) -> dict[str, Any]:
    """The fields of an `Error` that name the request which it answers; the request's fields may hold any values."""
    kind, robot, seq = data.get("type"), data.get("robot"), data.get("seq")
    return {
        "request": _text(kind) if isinstance(kind, str) else None,
        "robot": _text(robot) if isinstance(robot, str) else None,
        "seq": seq if isinstance(seq, int) and not isinstance(seq, bool) and abs(seq) < 2**63 else None,
    }


def _text(name: str) -> str:
    """A name as it can be sent: JSON can smuggle in half a surrogate pair, which is no text."""
    return name[:_LONGEST_NAME].encode(errors="replace").decode()


def unknown_robot(robot: str) -> Reason:
    """The cell has no such robot."""
    return Reason(code=ReasonCode.UNKNOWN_ROBOT, what=robot)


def at_fault(dq: object, robot: RobotDescription, code: ReasonCode) -> Reason:
    """What is wrong with a `dq` that could not be decoded.

    Args:
        dq: the value received.
        robot: the robot it was meant for.
        code: what the codec found.

    Returns:
        For a wrong length, both lengths; for an element that is not finite, the joint's name; for one that is too
        large, its value and bound too.
    """
    joints = robot.joint_names
    if not isinstance(dq, list):
        return Reason(code=code, what="dq")
    if len(dq) != len(joints):
        return Reason(code=ReasonCode.BAD_SHAPE, what="dq", value=float(len(dq)), bound=float(len(joints)))
    for joint, element in zip(joints, dq, strict=True):
        if element is None or (isinstance(element, float) and not math.isfinite(element)):
            return Reason(code=code, what=joint)
        if isinstance(element, int | float) and abs(element) > MOST_OF_A_JOINT:
            value = float(max(-MOST, min(element, MOST)))
            return Reason(code=code, what=joint, value=value, bound=MOST_OF_A_JOINT)
    return Reason(code=code, what="dq")
