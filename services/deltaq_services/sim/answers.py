"""The gate's answers, as messages."""

from __future__ import annotations

from deltaq_cell.group import Nearest
from deltaq_protocol import topics
from deltaq_protocol.guarded import CommandReply
from deltaq_protocol.messages import NearestPair, Outcome, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.outputs import ToTopic
from deltaq_services.sim.gate import Decision


def reply(id_: int, code: ReasonCode | None = None, message: str = "") -> ToTopic:
    """The reply to a command: taken or, with a code, why not."""
    answer = CommandReply(id=id_, accepted=code is None, code=code, message=message)
    return ToTopic(topics.COMMAND_REPLY, "", answer)


def verdict_of(
    robot: str, cycle: int, setpoint_cycle: int, seq: int, decision: Decision, cycle_s: float
) -> Verdict:
    """A decision on the increment `seq` and the state of `cycle`, for the setpoint of `setpoint_cycle`."""
    near = decision.binding.nearest if decision.binding is not None else None
    return Verdict(
        robot=robot,
        cycle=cycle,
        seq=seq,
        outcome=decision.outcome,
        setpoint_cycle=None if decision.outcome is Outcome.HELD else setpoint_cycle,
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
