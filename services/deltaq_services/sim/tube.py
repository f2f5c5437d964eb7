"""The tube: every configuration that a robot can be in from now until its brake has ended.

The drives lag. A robot that was sent the setpoints c_1, c_2, ... is, at the time of c_t, in the hull of the last few
of them or little beside it. Stable drives that lag alike and do not overshoot are at a weighted mean of past setpoints.
`DriveBounds` bounds how far real ones are from there. The tube is therefore a sequence of overlapping windows. Each is
the hull of `lag` + 1 consecutive setpoints and what lies beside it, held by a span of a few of them. The tube does
not say at which time the robot is where, so tubes of two robots are compared as sets.

With a lookahead several admissions are under way at a time, each due in a cycle of its own and each following the one
before it. Any of them may be lost or come too late. A Robot Server then takes none of those after it, since they
continue a motion that did not happen, and brakes from where the chain broke. So there is one course for each
admission in flight, up to it and then along its brake, beside the course of the present brake.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from deltaq_cell.description import GateDescription, RobotDescription
from deltaq_cell.kernel.course import course_points
from deltaq_cell.kernel.span import SHORTEST, span_around, widths
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, ServerState
from deltaq_protocol.setpoint_motion import SetpointMotion

_ROUNDING = 1e-9
"""Share of a cycle that rounding adds to a lag of whole cycles."""


@dataclass(frozen=True)
class DriveBounds:
    """Bounds of how the drives of a robot follow its setpoints.

    Attributes:
        lag: how many setpoints back they may be.
        tolerance: (n,) how far each joint may be beside the hull of those setpoints at rest [rad or m].
        spread: half of the greatest difference between the lags of two joints [cycles].
    """

    lag: int
    tolerance: Array
    spread: float


def drives_of(description: RobotDescription, gate: GateDescription, cycle_s: float) -> DriveBounds:
    """The drives of a robot as a cell describes them; `servo_lag_s` counts from the sending of a setpoint."""
    lag = max(1, math.ceil(gate.servo_lag_s / cycle_s - _ROUNDING))
    # a copy, since the kernel takes no array that cannot be written to
    return DriveBounds(lag, description.tracking_tolerance.copy(), gate.servo_lag_spread_s / cycle_s / 2)


@dataclass(frozen=True)
class Branch:
    """A candidate trajectory from the present setpoint: along a path, then `dq` and its brake, sent up to `step`.

    `step` -1 means that `dq` itself is still to be sent. The path is that of admissions in flight, empty if there are
    none before `dq`: setpoints, each (n,) [rad or m].
    """

    dq: Array
    brake_cycles: int
    step: int
    path: tuple[Array, ...] = ()

    def setpoints(self, q_cmd: Array) -> Array:
        """(m, n) setpoints still to come after `q_cmd`, m = 0 at rest [rad or m]."""
        return self.after(q_cmd[None])[0][1:]

    def after(self, past: Array) -> tuple[Array, bool]:
        """Setpoints (m, n) of the past and then those still to come [rad or m], and whether any of them differ."""
        path = np.array(self.path) if self.path else past[:0]
        return course_points(past, path, self.dq, self.brake_cycles, self.step)


class Piece(Protocol):
    """A part of a tube."""

    def span(self) -> Span:
        """A span of joint space that holds the piece."""
        ...

    def halves(self) -> tuple[Piece, ...]:
        """Two pieces that together are this one; none if it cannot be divided further."""
        ...


@dataclass(frozen=True)
class Span:
    """The hull of a few vertices of joint space, widened by `deviation`.

    Attributes:
        middle: (n,) of a box around it [rad or m].
        half: (n,) half-widths of that box.
        offsets: (vertices, n) of the vertices from the middle.
        deviation: (n,) half-width beside the hull.
        is_straight: whether it is one line, along which all joints lag alike.
    """

    middle: Array
    half: Array
    offsets: Array
    deviation: Array
    is_straight: bool = False

    @classmethod
    def around(cls, points: Array, tolerance: Array, spread: float) -> Span:
        """A span that holds every configuration of the drives in a part of a course.

        Args:
            points: (k, n) setpoints of that part [rad or m].
            tolerance: (n,) as `DriveBounds` has it.
            spread: likewise.
        """
        middle, half, offsets, deviation = span_around(points)
        width = widths(points, tolerance, spread)
        bent = np.maximum(deviation, width - tolerance).max()
        return cls(
            middle, half + width, offsets, deviation + width, len(offsets) <= 2 and bool(bent < SHORTEST)
        )

    def span(self) -> Span:
        """Itself."""
        return self

    def halves(self) -> tuple[Piece, ...]:
        """Two spans that together cover this one: the midpoint of the farthest two vertices replaces either of them.

        A mean of the vertices to which one of the two contributes more than the other is also one of that half's
        vertices. There are none if those two are so near that no drive resolves them, or that the span is as wide.
        """
        joint = int(np.argmax(np.ptp(self.offsets, axis=0)))
        ends = int(np.argmin(self.offsets[:, joint])), int(np.argmax(self.offsets[:, joint]))
        if np.ptp(self.offsets[:, joint]) / 2 < max(SHORTEST, float(self.deviation.max())):
            return ()
        between = self.offsets[list(ends)].mean(axis=0)
        return self._with(ends[1], between), self._with(ends[0], between)

    def _with(self, vertex: int, offset: Array) -> Span:
        """The same with another vertex."""
        offsets = self.offsets.copy()
        offsets[vertex] = offset
        shift = (offsets.min(axis=0) + offsets.max(axis=0)) / 2
        half = np.ptp(offsets, axis=0) / 2 + self.deviation
        return Span(self.middle + shift, half, offsets - shift, self.deviation)


@dataclass(frozen=True)
class Windows:
    """Windows `first` ... `last` of a tube; window t holds the robot when setpoint t is being sent.

    Attributes:
        points: (k, n) setpoints, past and to come [rad or m].
        drives: how they follow them.
    """

    points: Array
    drives: DriveBounds
    first: int
    last: int

    def span(self) -> Span:
        """A span around all setpoints of the windows."""
        return self._span

    @cached_property
    def _span(self) -> Span:
        first = max(0, min(self.first - self.drives.lag, len(self.points) - 1))
        return Span.around(self.points[first : self.last + 1], self.drives.tolerance, self.drives.spread)

    def halves(self) -> tuple[Piece, ...]:
        """Half of the windows each; of a single window, or of all along one line, the halves of their span."""
        if self.first == self.last or self.span().is_straight:
            return self.span().halves()
        middle = (self.first + self.last) // 2
        return replace(self, last=middle), replace(self, first=middle + 1)


def tube(history: Array, branch: Branch, drives: DriveBounds, measured: Array | None = None) -> Windows:
    """The tube of one course.

    Args:
        history: (m, n) the last setpoints, oldest first, ending with the present one [rad or m]. Where there are more
            than the drives' lag says, the drives may still be at any of them.
        branch: the setpoints from here on.
        drives: bounds of how the robot follows.
        measured: (n,) measured configuration, if the history does not explain it.
    """
    past = history if measured is None else np.concatenate((measured[None], history))
    if len(past) - 1 > drives.lag:
        drives = replace(drives, lag=len(past) - 1)
    points, moves = branch.after(past)
    now = len(past) - 1
    return Windows(points, drives, now, len(points) - 1 + drives.lag if moves else now)


def motions(now: SetpointMotion, cycle: int, chain: Sequence[Admission], cycles: int) -> list[SetpointMotion]:
    """The motion of a robot in the next cycles if it takes all admissions of a chain.

    Args:
        now: its motion in `cycle`.
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


def up_to(sequence: int, chain: Sequence[Admission]) -> Sequence[Admission]:
    """The part of a chain that ends with an admission; empty if that is not in it."""
    taken = [admission.sequence for admission in chain]
    return chain[: taken.index(sequence) + 1] if sequence in taken else ()


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
