"""Checks whether this gate can have caused a Robot Server's state; other states are rejected.

A setpoint moves by admissions of this gate and by the brake that came with each; a hold ends by a reset that this gate
ordered; cycles are counted one by one, and a robot whose gate is silent is held. A state that contradicts this comes
from a fault, from two gates, or from a forger. The gate cannot tell which.
"""

from collections.abc import Sequence

import numpy as np

from deltaq_protocol.guarded import Admission, ServerState
from deltaq_protocol.messages import Phase
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.phases import MAY_MOVE
from deltaq_services.sim.tube import motions, up_to

_SUMS = 1e-9
"""Rounding of a setpoint when increments are added in another order [rad or m]."""


def impossible(
    state: ServerState,
    before: ServerState | None,
    in_flight: Sequence[Admission],
    epoch: int,
    resets: int,
    longest_gap: int,
) -> str | None:
    """Why this gate cannot have caused a state, as text; None if it can.

    Args:
        state: of a robot, as it has just come.
        before: the newest accepted state; None before the first.
        in_flight: the admissions that it could still take then, as a chain.
        epoch: of this gate.
        resets: the count of resets that this gate has ordered the robot to reach.
        longest_gap: greatest number of cycles without a state; a robot that may move is held long before.
    """
    if before is None or state.process != before.process:
        return None  # a process that starts is held until a reset, whatever its state says
    leap = state.cycle - before.cycle
    if leap < -longest_gap:
        return f"cycle {state.cycle} after cycle {before.cycle}"
    if leap <= 0:
        return None  # overtaken, or said again
    if leap > longest_gap and state.phase in MAY_MOVE:
        return f"cycle {state.cycle} after cycle {before.cycle}, and it may move"
    if before.phase is Phase.HELD and state.phase in MAY_MOVE and state.resets <= before.resets:
        return "a hold that ended without a reset"
    if state.epoch == epoch:
        if state.resets > resets:
            return f"reset {state.resets}, of which {resets} were ordered"
        if (said := _not_admitted(state, before, in_flight)) is not None:
            return said
    elif state.sequence != before.sequence:
        return None  # it follows an earlier gate, whose last admissions are unknown here
    if state.resets != before.resets or before.phase is Phase.OFFLINE:
        return None  # it has begun where its KRC said
    joint = _off_course(state, before, in_flight)
    return None if joint is None else f"a setpoint of joint {joint + 1} that no admission leads to"


def _off_course(state: ServerState, before: ServerState, in_flight: Sequence[Admission]) -> int | None:
    """The joint whose setpoint is not on the course that began at the one before; None if all are.

    An admission is valid for its own cycle only, and only behind the one that it follows, so that there is no other
    course to the admission that a state follows than the one through all before it.
    """
    if state.q_cmd == before.q_cmd:
        return None
    chain = up_to(state.sequence, in_flight)
    longest = chain[-1].cycle - before.cycle + chain[-1].brake_cycles if chain else before.plan.brake_cycles
    course = motions(SetpointMotion.of(before), before.cycle, chain, min(state.cycle - before.cycle, longest))
    if tuple(course[-1].q_cmd.tolist()) == state.q_cmd:
        return None
    off = np.abs(np.array([motion.q_cmd for motion in course]) - state.q_cmd)
    nearest = off[off.max(axis=1).argmin()]
    return None if nearest.max() <= _SUMS else int(nearest.argmax())


def _not_admitted(state: ServerState, before: ServerState, in_flight: Sequence[Admission]) -> str | None:
    """Why this gate has not admitted the plan in a state of this epoch; None if it has."""
    told = (state.plan.dq, state.plan.brake_cycles)
    rests = not any(state.plan.dq) and not any(state.dq)
    taken = next((one for one in in_flight if one.sequence == state.sequence), None)
    if taken is not None:
        admitted = (taken.dq, taken.brake_cycles)
    elif state.epoch == before.epoch and state.sequence == before.sequence:
        admitted = (before.plan.dq, before.plan.brake_cycles)
    elif state.sequence == 0 and rests:
        return None  # linked, or reset
    else:
        return f"sequence {state.sequence}, which was not admitted"
    return None if rests or told == admitted else f"a plan that sequence {state.sequence} is not"
