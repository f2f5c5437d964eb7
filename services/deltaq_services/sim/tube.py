"""The tube: every configuration that a robot can be in from now until its brake has ended.

The drives lag. A robot that was sent the setpoints c_1, c_2, ... is, at the time of c_t, somewhere in the hull
of the last few of them: stable drives without overshoot that lag alike are at a weighted mean of past setpoints. The
tube is therefore a sequence of overlapping windows, each the hull of `lag` + 1 consecutive setpoints, held by a strip
along it. It makes no statement of when the robot is where, so tubes of two robots can be compared as sets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from deltaq_cell.kernel.motion import course_points
from deltaq_cell.kernel.strip import strip_around
from deltaq_protocol.arrays import Array

_SHORTEST = 1e-7
"""Strips are not divided below this half-length [rad or m]."""


@dataclass(frozen=True)
class Branch:
    """One course a robot may take from its present setpoint: along a path, then `dq` and its brake, sent up to `step`.

    `step` -1 means that `dq` itself is still to be sent. The path is that of admissions in flight, empty if there are
    none before `dq`: setpoints, each (n,) [rad or m].
    """

    dq: Array
    brake_cycles: int
    step: int
    path: tuple[Array, ...] = ()

    def setpoints(self, q_cmd: Array) -> Array:
        """(m, n) setpoints still to come after `q_cmd`, m = 0 at rest [rad or m]."""
        steps = np.arange(self.step + 1, self.brake_cycles)
        start = self.path[-1] if self.path else q_cmd
        if not self.dq.any() or steps.size == 0:
            to_come = np.empty((0, q_cmd.size))
        else:
            share = np.cumsum((self.brake_cycles - steps) / self.brake_cycles)
            to_come = start + share[:, None] * self.dq
        return np.vstack([*self.path, to_come])


class Piece(Protocol):
    """A part of a tube."""

    def strip(self) -> Strip:
        """A strip of joint space that holds the piece."""
        ...

    def halves(self) -> tuple[Piece, ...]:
        """Two pieces that together are this one; none if it cannot be divided further."""
        ...


@dataclass(frozen=True)
class Strip:
    """What lies within `middle + t * direction + e`, |t| <= 1 and |e_j| <= `deviation_j`, each (n,) [rad or m]."""

    middle: Array
    direction: Array
    deviation: Array

    @classmethod
    def around(cls, points: Array) -> Strip:
        """A strip along the longest way between any of the points, (k, n) [rad or m], that holds their hull."""
        return cls(*strip_around(points))

    def strip(self) -> Strip:
        """Itself."""
        return self

    @property
    def half(self) -> Array:
        """(n,) half-widths of the box around it [rad or m]."""
        return np.abs(self.direction) + self.deviation

    def halves(self) -> tuple[Piece, ...]:
        """Two strips of half the length, down to one that no drive resolves or that is as wide as it is long."""
        if np.abs(self.direction).max() < max(_SHORTEST, float(self.deviation.max())):
            return ()
        half = self.direction / 2
        return replace(self, middle=self.middle - half, direction=half), replace(
            self, middle=self.middle + half, direction=half
        )


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

    def strip(self) -> Strip:
        """A strip around all setpoints of the windows."""
        return self._strip

    @cached_property
    def _strip(self) -> Strip:
        first = max(0, min(self.first - self.lag, len(self.points) - 1))
        return Strip.around(self.points[first : self.last + 1])

    def halves(self) -> tuple[Piece, ...]:
        """Half of the windows each; of a single window, or of all along one line, the halves of their strip."""
        if self.first == self.last or self.strip().deviation.max() < _SHORTEST:
            return self.strip().halves()
        middle = (self.first + self.last) // 2
        return replace(self, last=middle), replace(self, first=middle + 1)


def tube(history: Array, branch: Branch, lag: int, measured: Array | None = None) -> Windows:
    """The tube of one course.

    Args:
        history: (m, n) the last setpoints, oldest first, ending with the present one [rad or m].
        branch: what is sent from here on.
        lag: how many setpoints back the drives may be.
        measured: (n,) where the robot is, if that is not within what the history explains.
    """
    past = history if measured is None else np.concatenate((measured[None], history))
    path = np.array(branch.path) if branch.path else past[:0]
    # past, then `branch.setpoints`
    points, moves = course_points(past, path, branch.dq, branch.brake_cycles, branch.step)
    now = len(past) - 1
    return Windows(points, lag, now, len(points) - 1 + lag if moves else now)
