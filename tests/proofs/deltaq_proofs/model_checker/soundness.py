"""Whether the gate covers the course that a robot really takes.

The gate certifies the motion of one robot against every course that it believes the other may take. That is sound
only if the true course is among them, or lies within them, whatever was lost on the way.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate

import numpy as np

from deltaq_proofs.model_checker.safety_monitor import Property, Violation
from deltaq_protocol.brake import brake_increment
from deltaq_protocol.guarded import TrackerMemory


def judge(gate: TrackerMemory, q_cmd: float, course: tuple[float, ...]) -> None:
    """Hold the setpoint and the course after it against what the gate believes.

    Args:
        gate: what the gate remembers of the robot.
        q_cmd: the setpoint just sent [m].
        course: increments still to be sent [m].

    Raises:
        Violation: if the robot is, or will be, outside the courses that the gate believes possible.
    """
    if gate.state is None:
        return
    history = [setpoint[0] for setpoint in gate.history]
    plan, here = gate.state.plan, history[-1]
    believed = [*history, *_places(here, plan.dq, plan.brake_cycles, plan.step + 1)]
    for flight in gate.in_flight:
        believed += _places(flight.follows_q_cmd[0], flight.dq, flight.brake_cycles, 0)
    for place in accumulate(course, initial=q_cmd):
        if not min(believed) <= place <= max(believed):
            raise Violation(
                Property.KNOWN,
                f"the robot comes to {place:g}, the gate believes {min(believed):g} to {max(believed):g}",
            )


def _places(q_cmd: float, dq: tuple[float, ...], brake_cycles: int, step: int) -> Iterator[float]:
    """The setpoints of a brake from one of its steps on."""
    increments = (
        float(brake_increment(np.array(dq), brake_cycles, k)[0]) for k in range(step, brake_cycles + 1)
    )
    return accumulate(increments, initial=q_cmd)
