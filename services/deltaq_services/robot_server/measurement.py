"""The interface between a Robot Server and its robot: the driver, and its measurement in each cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.setpoint_motion import SetpointMotion


class Driver(Protocol):
    """Interface of a robot's driver for the loop of its Robot Server; the link is the driver's own matter."""

    @property
    def is_guarded(self) -> bool:
        """Whether a process is ready to brake the robot should this one die, where one is wanted."""
        ...

    @property
    def detail(self) -> str:
        """Faults and facts, as text."""
        ...

    @property
    def q_sent(self) -> Array:
        """(n,) setpoint that the robot was sent last [rad or m]."""
        ...

    def wait(self) -> float:
        """Wait for the robot's next cycle, or until it counts as lost; returns the time [s], on a monotonic clock."""
        ...

    def read(self, now_s: float) -> Measurement | None:
        """What the robot reports; None if there is no cycle to be decided. If there is an error, nothing was read."""
        ...

    def is_lost(self, now_s: float) -> bool:
        """Whether the robot has been silent for so long that it counts as lost; asked where `read` gave nothing."""
        ...

    def write(self, q_cmd: Array, outputs: Mapping[str, bool], stop: bool) -> bool:
        """Make the reply to the robot; returns False if it repeats the last setpoint instead of `q_cmd` (n,)."""
        ...

    def send(self, motion: SetpointMotion) -> None:
        """Send a setpoint. The crash brake's process continues from `motion` if this process dies."""
        ...

    def mend(self, now_s: float) -> None:
        """Restart helper processes that have ended; called between two cycles."""
        ...


@dataclass(frozen=True)
class Settling:
    """Measures how long the setpoint of one robot has rested, and whether the robot still moves.

    Attributes:
        tolerance: (n,) how far the robot may be from where it was sent [rad or m].
        lag_cycles: cycles within which the drives are where they were sent.
        cycles_at_rest: cycles for which the setpoint has rested, counted up to one more than the lag.
        q_settled: (n,) measured configuration when the lag had passed [rad or m]; None before.
    """

    tolerance: Array
    lag_cycles: int
    cycles_at_rest: int = 0
    q_settled: Array | None = None

    @property
    def at_rest(self) -> bool:
        """Whether the setpoint has rested for as long as the drives lag."""
        return self.cycles_at_rest > self.lag_cycles

    def measured(self, q: Array) -> Self:
        """Take the measured configuration `q` (n,)."""
        if not self.at_rest:
            return replace(self, q_settled=None)
        return self if self.q_settled is not None else replace(self, q_settled=q)

    def sent(self, moves: bool) -> Self:
        """Count a sent setpoint, which moves or rests."""
        cycles = 0 if moves else min(self.cycles_at_rest + 1, self.lag_cycles + 1)
        return self if cycles == self.cycles_at_rest else replace(self, cycles_at_rest=cycles)

    def is_near(self, q: Array, other: Array) -> bool:
        """Whether two places, each (n,), are no further apart than the tolerance."""
        return bool((np.abs(q - other) <= self.tolerance).all())

    def goes_on(self, q: Array) -> bool:
        """Whether a robot at `q` (n,) still moves after the time in which the drives settle."""
        return self.q_settled is not None and not self.is_near(q, self.q_settled)


@dataclass(frozen=True)
class Measurement:
    """The report of a robot's driver at the start of a cycle.

    Attributes:
        ipoc: the KRC's stamp of this cycle.
        q: (n,) measured configuration [rad or m].
        q_start: (n,) setpoint of the KRC in a session that begins; None within a session.
        missed_last: the KRC reports that the reply to its last telegram did not reach it in time.
        inputs: digital inputs by name.
        resumes: the session that begins has the correction that was sent last in it.
        cycle_known: the robot's controller was seen to tick as the cell says.
        cycle_fault: the fault of the cycle, as text; empty without one.
    """

    ipoc: int
    q: Array
    q_start: Array | None = None
    missed_last: bool = False
    inputs: Mapping[str, bool] = field(default_factory=dict)
    resumes: bool = False
    cycle_known: bool = True
    cycle_fault: str = ""
