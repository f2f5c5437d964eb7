"""A jitter buffer: increments of a distant controller wait here for their turn, one a cycle.

On a long way increments come unevenly: none in one cycle, three in the next. Each would be the newest for a moment, the
robot would brake in the gaps, and most of the motion would be lost. So each waits until as many cycles have passed
since the state that it answers as nearly all of those before it needed, and goes to the gate then. What that costs is a
constant delay, with which a controller can reckon; `deltaq_protocol.in_flight` does. The motion of one that comes after
its turn is carried over (`carried_motion`).

Pure: cycles are handed in.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_travel
from deltaq_protocol.guarded import Plan
from deltaq_protocol.messages import Increment, Joints, Playout
from deltaq_services.containment import Part
from deltaq_services.outputs import Sender

# An increment that passed all checks of the HLI.


@dataclass(frozen=True, slots=True)
class Asked:
    """A checked increment, with its sender, its lease, and the cycle in which it came."""

    increment: Increment
    lease_epoch: int
    sender: Sender | None
    came: int


# Deferred motion: of increments that came after their turn; it is added to later ones, a little in each cycle.
#
# In a cycle without an increment the robot brakes, but it moves on meanwhile. So an increment that comes a cycle
# late is deferred less the motion of the brake. The rest is spread over some cycles, since a joint could not
# accelerate for all of it at once.
#
# Pure: the caller passes cycles and increments.

SPREAD_CYCLES = 8
"""In each cycle this part of the deferred motion is added. The speed is then greater by an eighth for one deferred
increment, and falls back by itself. All at once, or evenly, would ask for more than joints can brake.
"""

_CARRIED_FOR_CYCLES = 5 * SPREAD_CYCLES
"""After so many cycles less than a hundredth is left, and goes out whole."""

MOST_CARRIED_CYCLES = 12
"""Later increments are refused: they are of no use any more. At most this many greatest increments are deferred."""


class CarriedMotion(Part):
    """The deferred motion of one robot: requested and not yet sent, less the unrequested motion of its brake.

    Args:
        max_dq: (n,) largest increment [rad or m].
        max_dv: (n,) largest change of it from one cycle to the next [rad or m].
    """

    def __init__(self, max_dq: Array, max_dv: Array) -> None:
        self._max_dq, self._max_dv = max_dq, max_dv
        self.forget()

    @classmethod
    def of(cls, robot: RobotDescription, cycle_s: float) -> CarriedMotion:
        """That of a robot with sample time `cycle_s`."""
        return cls(robot.max_velocity * cycle_s, robot.max_acceleration * cycle_s**2)

    @property
    def owed(self) -> tuple[float, ...] | None:
        """(n,) deferred motion [rad or m]; None if there is none."""
        owed = self._owed - self._unasked
        return tuple(owed.tolist()) if owed.any() else None

    def asked(self, dq: Sequence[float]) -> None:
        """Defer the motion of an increment (n,) that missed its turn, up to the greatest increment."""
        self._owe(np.array(dq, dtype=np.float64).clip(-self._max_dq, self._max_dq))

    def moved(self, dq: Array, cycles: int) -> None:
        """The robot moved by (n,) in so many cycles that had no increment, since one had its turn [rad or m]."""
        self._unasked, self._unasked_cycles = dq, cycles

    def settle(self, missing: int) -> None:
        """Note that an increment has its cycle again; unrequested motion of the brake will be compensated.

        `missing` counts lost increments; the motion of as many cycles is not compensated.
        """
        if self._unasked.any() and missing < self._unasked_cycles:
            self._owe(-self._unasked * (1.0 - missing / self._unasked_cycles))
        self._unasked, self._unasked_cycles = np.zeros_like(self._max_dq), 0

    def forget(self) -> None:
        """Drop all deferred motion."""
        self._owed, self._cycles_left = np.zeros_like(self._max_dq), 0
        self._unasked, self._unasked_cycles = np.zeros_like(self._max_dq), 0

    def add_to(self, dq: Sequence[float], last_dq: Sequence[float] | None) -> tuple[float, ...]:
        """The increment whose turn it is, plus a part of the deferred motion; unchanged if there is none.

        A robot that has braked returns to its speed as fast as its limits allow, and the motion missed until then is
        deferred, too. All deferred motion finally goes to the gate, which scales a sum that is too large, and reports
        this. An increment that is too large for any cycle goes to the gate by itself.

        Args:
            dq: (n,) the increment [rad or m].
            last_dq: (n,) the increment sent before [rad or m]; None if it is not known.

        Returns:
            (n,) the increment to request from the gate.
        """
        asked = np.array(dq, dtype=np.float64)
        if not self._cycles_left or (np.abs(asked) > self._max_dq).any():
            return tuple(dq)
        self._cycles_left -= 1
        share = self._owed / SPREAD_CYCLES if self._cycles_left else self._owed
        wanted, self._owed = asked + share, self._owed - share
        if self._cycles_left and last_dq is not None:
            last = np.array(last_dq, dtype=np.float64)
            slowest = np.maximum(-self._max_dq, last - self._max_dv)
            fastest = np.minimum(self._max_dq, last + self._max_dv)
            reached = wanted.clip(slowest, fastest)
            self._owed = self._bounded(self._owed + (wanted - reached))
            wanted = reached
        return tuple(wanted.tolist())

    def _owe(self, dq: Array) -> None:
        self._owed = self._bounded(self._owed + dq)
        self._cycles_left = _CARRIED_FOR_CYCLES

    def _bounded(self, owed: Array) -> Array:
        most = MOST_CARRIED_CYCLES * self._max_dq
        return owed.clip(-most, most)


_REMEMBERED = 250
"""Increments whose time under way is remembered, 3 s of them at 12 ms; as many must have been quicker before the delay
becomes shorter."""

_LATE_SHARE = 0.05
"""Increments that may come too late for their turn: their motion is carried over, and a longer delay would cost every
cycle. On links that lose packets a greater share and a smaller one let the camera follower err by more."""


class Fate(Enum):
    """Fate of an increment without a cycle of its own."""

    CARRIED = "later increments carry its motion"
    SUPERSEDED = "another answer to the same state was accepted"
    LATE = "it is too late for its cycle"


@dataclass(frozen=True, slots=True)
class Left:
    """An increment without a turn.

    Attributes:
        asked: the increment.
        fate: refused, or deferred.
        late_cycles: cycles since its turn.
    """

    asked: Asked
    fate: Fate
    late_cycles: int = 0


@dataclass(frozen=True, slots=True)
class PlayoutTurn:
    """The buffer's output in a cycle.

    Attributes:
        asked: the increment whose turn it is, if there is one, with a part of the deferred motion.
        left: increments whose turn is over.
    """

    asked: Asked | None
    left: Sequence[Left]


class PlayoutBuffer(Part):
    """Increments of one lease until their turn.

    Args:
        max_cycles: how long an increment may be under way.
        carried: takes the motion of those that come too late.

    Attributes:
        max_cycles, carried: as given.
    """

    def __init__(self, max_cycles: int, carried: CarriedMotion) -> None:
        self.max_cycles = max_cycles
        self.carried = carried
        self._under_way_cycles: deque[int] = deque(maxlen=_REMEMBERED)
        self._waiting: dict[int, Asked] = {}
        self._delay_cycles = 0
        self._needed_lately: list[int] = []
        self._newest_cycle = self._answered_cycle = self._passed_on_in = -1
        self._late = self._empty = 0
        self._settled: set[int] = set()

    def put(self, asked: Asked, newest_cycle: int) -> Left | None:
        """Keep an increment for its turn, or say that its turn is over.

        Args:
            asked: the increment, not older than `max_cycles`.
            newest_cycle: of the robot's newest state.

        Returns:
            The increment in whose place it came, or itself if others behind it were passed on.
        """
        cycle = asked.increment.cycle
        # it cannot be passed on before the next state
        self._under_way_cycles.append(newest_cycle + 1 - cycle)
        self._adapt_delay()
        if cycle <= self._answered_cycle:
            return self._left(asked, newest_cycle)
        replaced = self._waiting.get(cycle)
        self._waiting[cycle] = asked
        return None if replaced is None else Left(replaced, Fate.SUPERSEDED)

    def moved(self, newest_cycle: int, plan: Plan) -> None:
        """Take a state with its robot's plan, and account for braking in cycles without an increment.

        After a longer pause than motion is carried for, all deferred motion is dropped.
        """
        self._newest_cycle = newest_cycle
        empty = newest_cycle - self._passed_on_in - 1
        if self._passed_on_in < 0 or not 0 <= empty <= MOST_CARRIED_CYCLES:
            self.carried.forget()
            return
        dq, braked = np.array(plan.dq), min(plan.step, empty)
        before = brake_travel(dq, plan.brake_cycles, plan.step - braked)
        self.carried.moved(before - brake_travel(dq, plan.brake_cycles, plan.step), empty)

    def turn(self, newest_cycle: int, last_dq: Sequence[float] | None = None) -> PlayoutTurn:
        """Take a state, and return the increment whose turn it is.

        Where there are several, as after the delay has become shorter, the newest takes the turn of all, and the motion
        of the others is carried over.

        Args:
            newest_cycle: of the state.
            last_dq: (n,) the increment that was sent last [rad or m]; None where that is not known.
        """
        if newest_cycle < self._passed_on_in:  # another Robot Server, which counts from one
            return self._begin_anew()
        due = sorted(cycle for cycle in self._waiting if newest_cycle - cycle >= self._delay_cycles)
        if not due:
            return PlayoutTurn(None, ())
        if self._answered_cycle >= 0:
            self.carried.settle(missing=due[-1] - self._answered_cycle - len(due))
        left = [self._left(self._waiting.pop(cycle), newest_cycle) for cycle in due[:-1]]
        asked = self._waiting.pop(due[-1])
        missed = newest_cycle - self._passed_on_in - 1
        if self._passed_on_in >= 0 and missed <= self.max_cycles:  # else the controller had paused
            self._empty += missed
        self._answered_cycle, self._passed_on_in = due[-1], newest_cycle
        self._settle(due[-1])
        dq = self.carried.add_to(asked.increment.dq, last_dq)
        return PlayoutTurn(replace(asked, increment=asked.increment.model_copy(update={"dq": dq})), left)

    def drop(self) -> list[Asked]:
        """Forget the increments that wait, and return them."""
        waiting = list(self._waiting.values())
        self._waiting.clear()
        self.carried.forget()
        return waiting

    def told(self) -> Playout:
        """The report for clients: before `turn`, the increments in the setpoint of the newest state."""
        planned: list[Joints] = []
        while (
            asked := self._waiting.get(self._newest_cycle - self._delay_cycles + len(planned))
        ) is not None:
            planned.append(asked.increment.dq)
        return Playout(
            delay_cycles=self._delay_cycles,
            waiting=len(self._waiting),
            answered_cycle=None if self._answered_cycle < 0 else self._answered_cycle,
            late=self._late,
            empty=self._empty,
            owed=self.carried.owed,
            planned=tuple(planned),
        )

    def _left(self, asked: Asked, newest_cycle: int) -> Left:
        self._late += 1
        cycle = asked.increment.cycle
        late_cycles = max(0, newest_cycle - cycle - self._delay_cycles)
        if cycle in self._settled:
            return Left(asked, Fate.SUPERSEDED, late_cycles)
        if late_cycles > MOST_CARRIED_CYCLES:
            return Left(asked, Fate.LATE, late_cycles)
        self._settle(cycle)
        self.carried.asked(asked.increment.dq)
        return Left(asked, Fate.CARRIED, late_cycles)

    def _settle(self, cycle: int) -> None:
        self._settled = {one for one in self._settled if cycle - one <= self.max_cycles} | {cycle}

    def _adapt_delay(self) -> None:
        """Longer at once, since a gap is a brake; shorter only after a while, since that takes a turn away."""
        needed = self._needed_cycles()
        if needed >= self._delay_cycles:
            self._delay_cycles, self._needed_lately = needed, []
            return
        self._needed_lately.append(needed)
        if len(self._needed_lately) >= _REMEMBERED:
            self._delay_cycles, self._needed_lately = max(self._needed_lately), []

    def _needed_cycles(self) -> int:
        """The shortest delay for which all but few of the increments remembered would have been in time."""
        in_order = sorted(self._under_way_cycles)
        in_time = len(in_order) - int(_LATE_SHARE * len(in_order))
        return in_order[in_time - 1]

    def _begin_anew(self) -> PlayoutTurn:
        late = self.drop()
        self._late += len(late)
        self._answered_cycle = self._passed_on_in = -1
        self._settled = set()
        return PlayoutTurn(None, [Left(asked, Fate.LATE) for asked in late])
