"""The courses that a robot may take while admissions are in flight.

With a lookahead several admissions are under way at a time, each due in a cycle of its own and each following the one
before it. Any of them may be lost or come too late. A Robot Server then takes none of those behind it, since they
follow what did not happen, and brakes from where the chain broke. So there is one course for each admission in
flight, up to it and then along its brake, beside that of the brake which is under way now.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deltaq_protocol.guarded import Admission, ServerState
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.sim.tube import Branch


def motions(now: SetpointMotion, cycle: int, chain: Sequence[Admission], cycles: int) -> list[SetpointMotion]:
    """What a robot is sent in the next cycles if it takes all of a chain.

    Args:
        now: what it was sent in `cycle`.
        cycle: of its newest state.
        chain: admissions in flight, each following the one before it.
        cycles: how many.

    Returns:
        `now`, and a motion for each of the cycles.
    """
    due = {admission.cycle: admission for admission in chain}
    found = [now]
    for earlier in range(cycle, cycle + cycles):
        admission = due.get(earlier)
        found.append(found[-1].braked() if admission is None else found[-1].admitted(admission))
    return found


def courses(now: SetpointMotion, cycle: int, chain: Sequence[Admission]) -> dict[int, Branch]:
    """Every course, by the number of the admission that it ends with; the first is that of the present plan."""
    found = {now.sequence: Branch(now.plan_dq, now.brake_cycles, now.step)}
    if not chain:
        return found
    path = [motion.q_cmd for motion in motions(now, cycle, chain, chain[-1].cycle - cycle)]
    for admission in chain:
        before = tuple(path[1 : admission.cycle - cycle + 1])
        found[admission.sequence] = Branch(np.array(admission.dq), admission.brake_cycles, -1, before)
    return found


def still_due(state: ServerState, chain: Sequence[Admission]) -> tuple[Admission, ...]:
    """The admissions in flight that a robot in this state can still take.

    Its Robot Server compares each with what it has sent by then, exactly. What follows anything else is void.
    """
    motion, cycle = SetpointMotion.of(state), state.cycle
    due: list[Admission] = []
    for admission in chain:
        if admission.cycle < cycle:
            continue
        while cycle < admission.cycle:
            motion, cycle = motion.braked(), cycle + 1
        if admission.epoch != state.epoch or not motion.leads_to(admission):
            break
        due.append(admission)
        motion, cycle = motion.admitted(admission), cycle + 1
    return tuple(due)
