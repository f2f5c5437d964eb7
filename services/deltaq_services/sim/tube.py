"""The tube: every configuration that a robot can be in from now until its brake has ended.

The drives lag. A robot that was sent the setpoints c_1, c_2, ... is, at the time of c_t, somewhere in the hull
of the last few of them: a stable drive without overshoot is a weighted mean of past setpoints. The tube is
therefore a sequence of overlapping windows, each the box in joint space around `lag` + 1 consecutive setpoints.
It makes no statement of when the robot is where, so tubes of two robots can be compared as sets. Where the
setpoints of a window lie on one line, the robot is on that line too, since all of its drives lag alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.brake import brake_travel

Array = NDArray[np.float64]

_SHORTEST = 1e-7
"""Pieces of a line are not divided below this [rad or m]."""


@dataclass(frozen=True)
class Branch:
    """One course a robot may take from its present setpoint: `dq` and its brake, sent up to `step`.

    `step` -1 means that `dq` itself is still to be sent.
    """

    dq: Array
    brake_cycles: int
    step: int

    def setpoints(self, q_cmd: Array) -> Array:
        """(m, n) setpoints still to come after `q_cmd`, m = 0 at rest [rad or m]."""
        steps = np.arange(max(self.step + 1, 0), self.brake_cycles)
        if not self.dq.any() or steps.size == 0:
            return np.empty((0, q_cmd.size))
        share = np.cumsum((self.brake_cycles - steps) / self.brake_cycles)
        return q_cmd + share[:, None] * self.dq

    def end(self, q_cmd: Array) -> Array:
        """(n,) where the brake ends [rad or m]."""
        if self.step < 0:
            return q_cmd + self.dq + brake_travel(self.dq, self.brake_cycles, 0)
        return q_cmd + brake_travel(self.dq, self.brake_cycles, self.step)


class Piece(Protocol):
    """A part of a tube."""

    def box(self) -> tuple[Array, Array]:
        """Middle and half-widths, each (n,), of a box in joint space that holds the piece."""
        ...

    def halves(self) -> tuple[Piece, ...]:
        """Two pieces that together are this one; none if it cannot be divided further."""
        ...


@dataclass(frozen=True)
class Segment:
    """A straight piece of a path in joint space, from `start` to `end`, each (n,) [rad or m]."""

    start: Array
    end: Array

    def box(self) -> tuple[Array, Array]:
        """Middle and half-widths."""
        return (self.start + self.end) / 2, np.abs(self.end - self.start) / 2

    def halves(self) -> tuple[Piece, ...]:
        """Two halves, down to a length that no drive resolves."""
        if np.max(np.abs(self.end - self.start)) < _SHORTEST:
            return ()
        middle = (self.start + self.end) / 2
        return Segment(self.start, middle), Segment(middle, self.end)


@dataclass(frozen=True)
class Windows:
    """Windows `first` ... `last` of a tube; window t holds the robot when setpoint t is being sent.

    Attributes:
        points: (k, n) setpoints, past and to come [rad or m].
        lag: how many setpoints back the drives may be.
    """

    points: Array
    lag: int
    first: int
    last: int

    def box(self) -> tuple[Array, Array]:
        """Middle and half-widths."""
        points = self._points()
        low, high = points.min(axis=0), points.max(axis=0)
        return (low + high) / 2, (high - low) / 2

    def halves(self) -> tuple[Piece, ...]:
        """Half of the windows each; of a single window along a straight line, half of the line each."""
        if self.first < self.last:
            middle = (self.first + self.last) // 2
            return replace(self, last=middle), replace(self, first=middle + 1)
        points = self._points()
        low, high = points.min(axis=0), points.max(axis=0)
        start = points[np.argmin(points[:, np.argmax(high - low)])]
        end = low + high - start
        if not _on_one_line(points, start, end):
            return ()
        return Segment(start, end).halves()

    def _points(self) -> Array:
        first = max(0, min(self.first - self.lag, len(self.points) - 1))
        return self.points[first : self.last + 1]


def tube(history: Array, branch: Branch, lag: int, measured: Array | None = None) -> Windows:
    """The tube of one course.

    Args:
        history: (m, n) the last setpoints, oldest first, ending with the present one [rad or m].
        branch: what is sent from here on.
        lag: how many setpoints back the drives may be.
        measured: (n,) where the robot is, if that is not within what the history explains.
    """
    to_come = branch.setpoints(history[-1])
    past = history if measured is None else np.vstack([measured[None], history])
    points = np.vstack([past, to_come])
    now = len(past) - 1
    moves = bool((points != points[-1]).any())
    return Windows(points, lag, now, len(points) - 1 + lag if moves else now)


def _on_one_line(points: Array, start: Array, end: Array) -> bool:
    """Whether all points lie between `start` and `end` to within rounding."""
    along = end - start
    length = along @ along
    if length == 0.0:
        return True
    share = (points - start) @ along / length
    return bool(np.all(np.abs(points - start - share[:, None] * along) < _SHORTEST))
