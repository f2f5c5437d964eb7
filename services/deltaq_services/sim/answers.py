"""The gate's answers, as messages."""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_cell.group import Nearest
from deltaq_protocol import topics
from deltaq_protocol.guarded import CommandReply
from deltaq_protocol.messages import Message, NearestPair, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Topic
from deltaq_services.sim.gate import Decision


@dataclass(frozen=True)
class Output:
    """A message to publish, and the robot whose key it goes to ("" for keys without one)."""

    topic: Topic
    robot: str
    message: Message


def reply(id_: int, code: ReasonCode | None = None, message: str = "") -> Output:
    """The reply to a command: taken or, with a code, why not."""
    answer = CommandReply(id=id_, accepted=code is None, code=code, message=message)
    return Output(topics.COMMAND_REPLY, "", answer)


def verdict_of(robot: str, cycle: int, seq: int, decision: Decision, cycle_s: float) -> Verdict:
    """A decision on the increment `seq`, for the state of `cycle`."""
    near = decision.binding.nearest if decision.binding is not None else None
    return Verdict(
        robot=robot,
        cycle=cycle,
        seq=seq,
        outcome=decision.outcome,
        scale=decision.scale,
        dq=tuple(decision.dq.tolist()),
        time_to_stop_s=decision.brake_cycles * cycle_s,
        reasons=decision.reasons,
        clearance_m=near.distance_m if near is not None else None,
        pair=near.pair if near is not None else None,
    )


def nearest_pair(near: Nearest) -> NearestPair:
    """Two bodies with their witness points."""
    first, second = (tuple(point.tolist()) for point in near.points_m)
    return NearestPair(pair=near.pair, distance_m=near.distance_m, points_m=(first, second))
