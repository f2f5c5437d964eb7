"""What a driver tells a Robot Server's core of its robot, once a cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from deltaq_protocol.arrays import Array


@dataclass(frozen=True)
class Measurement:
    """What a robot's driver reports at the start of a cycle.

    Attributes:
        ipoc: the KRC's stamp of this cycle.
        q: (n,) measured configuration [rad or m].
        q_start: (n,) setpoint that the KRC has in the session that begins; None while the session goes on.
        missed_last: the KRC reports that the reply to its last telegram did not reach it in time.
        inputs: digital inputs by name.
        resumes: the session that begins has the correction that was sent last in it.
        cycle_known: the robot's controller was seen to tick as the cell says.
        cycle_fault: why it does not, for people; empty if nothing speaks against it.
    """

    ipoc: int
    q: Array
    q_start: Array | None = None
    missed_last: bool = False
    inputs: Mapping[str, bool] = field(default_factory=dict)
    resumes: bool = False
    cycle_known: bool = True
    cycle_fault: str = ""
