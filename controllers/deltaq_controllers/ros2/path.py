"""A path through points in time: cubic where both ends of a piece have velocities, straight where not.

So does the spline interpolation of `joint_trajectory_controller` ("Trajectory Representation" of its documentation),
whose third kind, quintic where accelerations are given as well, is not here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.arrays import Array

_Pieces = NDArray[np.intp]


class Path:
    """A continuous path in joint space over its own time, which begins at 0.

    Args:
        times_s: (m,) of the points, increasing from 0 [s].
        q: (m, n) positions [rad or m].
        velocities: (m, n) [rad/s or m/s]; a row that is not a number has none.

    Attributes:
        times_s: as given.
        duration_s: of the path [s].
    """

    def __init__(self, times_s: Array, q: Array, velocities: Array) -> None:
        self.times_s = times_s
        self.duration_s = float(times_s[-1])
        length_s, moved = np.diff(times_s)[:, None], np.diff(q, axis=0)
        begin, end = velocities[:-1], velocities[1:]
        is_cubic = np.isfinite(begin) & np.isfinite(end)
        mean = moved / length_s
        # Hermite's cubic by powers of the time since the piece began
        square = (3.0 * mean - 2.0 * begin - end) / length_s
        cube = (begin + end - 2.0 * mean) / length_s**2
        self._powers = (
            q[:-1],
            np.where(is_cubic, begin, mean),
            np.where(is_cubic, square, 0.0),
            np.where(is_cubic, cube, 0.0),
        )

    def at(self, times_s: Array) -> Array:
        """(k, n) positions at times (k,), which are kept within the path [rad or m]."""
        return self._position(*self._since(times_s))

    def velocity(self, times_s: Array) -> Array:
        """(k, n) velocities at times (k,) by the path's own time [rad/s or m/s]."""
        return self._velocity(*self._since(times_s))

    def acceleration(self, times_s: Array) -> Array:
        """(k, n) accelerations at times (k,) by the path's own time [rad/s^2 or m/s^2]."""
        piece, since = self._since(times_s)
        _, _, square, cube = (power[piece] for power in self._powers)
        acceleration: Array = 2.0 * square + 6.0 * since * cube
        return acceleration

    def corners(self) -> Array:
        """(m, n) by how much the velocity jumps at each point; the robot rests before the first and behind the last."""
        lengths_s = np.diff(self.times_s)[:, None]
        pieces = np.arange(len(self.times_s) - 1)
        begin, end = self._powers[1], self._velocity(pieces, lengths_s)
        rest = np.zeros((1, begin.shape[1]))
        jumps: Array = np.concatenate([begin, rest]) - np.concatenate([rest, end])
        return jumps

    def extremes(self) -> tuple[Array, Array, Array]:
        """Of each piece and joint the least and greatest position and the greatest speed, three of (m - 1, n)."""
        lengths_s = np.diff(self.times_s)[:, None]
        _, dq, square, cube = self._powers
        pieces = np.arange(len(lengths_s))
        with np.errstate(divide="ignore", invalid="ignore"):
            fastest_s = -square / (3.0 * cube)
            root = np.sqrt(square**2 - 3.0 * cube * dq)
            turning_s = [
                (-square + root) / (3.0 * cube),
                (-square - root) / (3.0 * cube),
                -dq / (2.0 * square),
            ]
        ends_s = [np.zeros_like(dq), np.broadcast_to(lengths_s, dq.shape)]
        places_s = [*ends_s, *(np.clip(np.nan_to_num(at_s), 0.0, lengths_s) for at_s in turning_s)]
        positions = np.array([self._position(pieces, at_s) for at_s in places_s])
        fast_s = [*ends_s, np.clip(np.nan_to_num(fastest_s), 0.0, lengths_s)]
        speeds = np.abs([self._velocity(pieces, at_s) for at_s in fast_s])
        return positions.min(axis=0), positions.max(axis=0), speeds.max(axis=0)

    def _since(self, times_s: Array) -> tuple[_Pieces, Array]:
        """The piece of each time (k,), and the time since it began (k, 1)."""
        within = np.clip(times_s, 0.0, self.duration_s)
        piece = np.clip(np.searchsorted(self.times_s, within, side="right") - 1, 0, len(self.times_s) - 2)
        return piece, (within - self.times_s[piece])[:, None]

    def _position(self, piece: _Pieces, since: Array) -> Array:
        q, dq, square, cube = (power[piece] for power in self._powers)
        position: Array = q + since * (dq + since * (square + since * cube))
        return position

    def _velocity(self, piece: _Pieces, since: Array) -> Array:
        _, dq, square, cube = (power[piece] for power in self._powers)
        velocity: Array = dq + since * (2.0 * square + 3.0 * since * cube)
        return velocity
