"""How fast a path may be driven at each place, so that the robot can slow down in time for what lies ahead."""

from __future__ import annotations

import numpy as np

from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.ros2.path import Path
from deltaq_protocol.arrays import Array

SHARE = 0.7
"""Share of the joints' acceleration limits that a bend or a corner of the path may take."""

_BRAKED = 0.9
"""Share that bends and slowing down for what is ahead take together."""

_MOST_PLACES = 20_000
_CYCLES_BEFORE = 2.0


class RateProfile:
    """The greatest rate at each place of a path: 1 drives it in its own time, less stretches the time.

    With the path's own time s and x = (ds/dt)^2 a joint's acceleration is q'' x + q' (dx/ds) / 2. Bends bound x by
    `SHARE`, the rest bounds how quickly x may fall. At a corner of a path of straight pieces the rate is such that one
    cycle's change of the increment suffices, so that the path is kept there too.

    Args:
        path: to be driven.
        limits: of the robot's increments.
        cycle_s: of the robot.
    """

    def __init__(self, path: Path, limits: IncrementLimits, cycle_s: float) -> None:
        with np.errstate(divide="ignore"):
            jump = np.minimum(1.0, (SHARE * limits.max_ddq / cycle_s / np.abs(path.corners())).min(axis=1))
        # the robot has slowed down for a corner before the cycle in which it passes it
        before_s = np.maximum(path.times_s - _CYCLES_BEFORE * cycle_s * jump, 0.0)
        spacing_s = max(cycle_s, path.duration_s / _MOST_PLACES)
        regular_s = np.arange(0.0, path.duration_s, spacing_s)
        self._places_s = np.unique(np.concatenate([regular_s, path.times_s, before_s]))
        max_acceleration = limits.max_ddq / cycle_s**2
        # a bend counts in the whole piece between two places: what is least of both its ends
        between_s = np.diff(self._places_s)
        inside = np.stack([self._places_s[:-1] + 1e-3 * between_s, self._places_s[1:] - 1e-3 * between_s])
        speed = np.abs([path.velocity(at_s) for at_s in inside]).max(axis=0)
        bend = np.abs([path.acceleration(at_s) for at_s in inside]).max(axis=0)
        with np.errstate(divide="ignore"):
            driven = np.minimum(1.0, (SHARE * max_acceleration / bend).min(axis=1))
            fall = ((_BRAKED * max_acceleration - driven[:, None] * bend) / speed).min(axis=1)
        most = np.minimum(np.append(driven, 1.0), np.append(1.0, driven))
        for at_s in (path.times_s, before_s):
            np.minimum.at(most, np.searchsorted(self._places_s, at_s), jump**2)
        self._squares = _reachable(most.tolist(), (2.0 * between_s * fall).tolist())

    def rate(self, times_s: Array) -> Array:
        """(k,) the greatest rate at times (k,) of the path."""
        rates: Array = np.sqrt(np.interp(times_s, self._places_s, self._squares))
        return rates

    def places_between(self, begin_s: float, end_s: float) -> Array:
        """(k,) times of the path within these two between which the rate does not bend."""
        first, last = np.searchsorted(self._places_s, (begin_s, end_s))
        return self._places_s[first:last]


def _reachable(most: list[float], falls: list[float]) -> Array:
    """From the end backwards: no place may be passed faster than the next one can be slowed down to."""
    reachable = most[-1:]
    for bound, fall in zip(reversed(most[:-1]), reversed(falls), strict=True):
        reachable.append(min(bound, reachable[-1] + fall))
    return np.array(reachable[::-1])
