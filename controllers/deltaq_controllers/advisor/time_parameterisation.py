"""Follow a path: its time parameterisation, and the next step from the robot's present configuration."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array

SHARE = 0.6
"""Fraction of the joints' speed and acceleration limits; the gate's own bounds are never reached."""

LOOK_AHEAD = 40
"""Cycles of the path among which the robot's position is searched for."""

TAKEN_BACK_CYCLES = 20.0
"""Cycles in which a deviation from the path after a brake is corrected."""


def timed(
    path: Array,
    tracker: ConstraintTracker,
    cycle_s: float,
    hands_move: bool = False,
    T_world_hands: Array | None = None,
) -> Array:
    """Setpoints of every cycle, with the hands exactly in place unless they move.

    Over the path's length s the speed is bounded by the joints' speeds, `|q'| v <= share v_max`, and their
    accelerations, half of which go to bends, `|q''| v^2`, and half to speeding up and slowing down, `|q'| dv/dt`.

    Args:
        path: (P, n) configurations.
        tracker: of the robot.
        cycle_s: sample time.
        hands_move: whether the path takes the hands elsewhere.
        T_world_hands: (h, 4, 4) where the hands are kept; by default where they are at the path's start.

    Returns:
        (T, n) setpoints from the path's start to its end, at rest at both; with the tolerances of the tracker's task
        after the joints if the hands are kept.
    """
    if hands_move:
        return _timed(path, tracker.robot, cycle_s)
    places = tracker.hands(path[0]) if T_world_hands is None else T_world_hands
    setpoints = _timed(np.array([tracker.with_tolerances(q, places) for q in path]), tracker.robot, cycle_s)
    held = tracker.track(setpoints[:, tracker.base], places, setpoints)
    # the ends are where the robot is and should be, to the bit
    between = np.array(np.isfinite(held).all(axis=1))
    between[[0, -1]] = False
    setpoints[between] = held[between]
    return setpoints


def _timed(path: Array, robot: RobotModel, cycle_s: float) -> Array:
    lengths = np.abs(np.diff(path, axis=0)).max(axis=1)
    path = path[np.append(True, lengths > 0.0)]
    lengths = lengths[lengths > 0.0]
    if not len(lengths):
        return path[:1]
    s = np.append(0.0, np.cumsum(lengths))
    slope = np.abs(np.diff(path, axis=0) / lengths[:, None])
    signed = np.diff(path, axis=0) / lengths[:, None]
    velocity, acceleration = robot.max_velocity[: path.shape[1]], robot.max_acceleration[: path.shape[1]]
    fastest = (SHARE * velocity / np.maximum(slope, 1e-9)).min(axis=1)
    pull = (0.5 * SHARE * acceleration / np.maximum(slope, 1e-9)).min(axis=1)
    bend = np.abs(np.diff(signed, axis=0)) / (0.5 * (lengths[1:] + lengths[:-1]))[:, None]
    at_bend = np.sqrt((0.5 * SHARE * acceleration / np.maximum(bend, 1e-9)).min(axis=1))
    v = np.zeros(len(path))
    v[1:-1] = np.minimum(np.minimum(fastest[1:], fastest[:-1]), at_bend)
    for k in range(1, len(v)):
        v[k] = min(v[k], np.sqrt(v[k - 1] ** 2 + 2.0 * pull[k - 1] * lengths[k - 1]))
    for k in range(len(v) - 2, -1, -1):
        v[k] = min(v[k], np.sqrt(v[k + 1] ** 2 + 2.0 * pull[k] * lengths[k]))
    if len(v) == 2:
        # one piece from rest to rest: speed up over its first half
        middle = 0.5 * (path[0] + path[1])
        return _timed(np.stack([path[0], middle, path[1]]), robot, cycle_s)
    durations = 2.0 * lengths / np.maximum(v[1:] + v[:-1], 1e-6)
    t = np.append(0.0, np.cumsum(durations))
    times = np.arange(0.0, t[-1], cycle_s)
    piece = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(durations) - 1)
    since = times - t[piece]
    gain = (v[piece + 1] - v[piece]) / durations[piece]
    travelled = np.clip(s[piece] + v[piece] * since + 0.5 * gain * since**2, s[piece], s[piece + 1])
    setpoints = np.column_stack([np.interp(travelled, s, column) for column in path.T])
    return np.concatenate([setpoints, path[-1:]])


class Route:
    """A timed path, and where on it the robot is.

    Args:
        setpoints: (T, n) of `timed`.

    Attributes:
        end: (n,) where it leads to.
    """

    def __init__(self, setpoints: Array) -> None:
        self._setpoints = setpoints
        self._place = 0
        self.end: Array = setpoints[-1]

    @property
    def done(self) -> float:
        """Fraction of the path's duration that has been driven."""
        return self._place / max(1, len(self._setpoints) - 1)

    def step(self, q: Array, cycles: float) -> Array:
        """The displacement (n,) along the path, from a robot at `q` (n,) near it.

        Args:
            q: setpoint [rad or m].
            cycles: how far to go, in cycles of the timed path.
        """
        window = self._setpoints[self._place : self._place + LOOK_AHEAD]
        self._place += int(np.abs(window - q).max(axis=1).argmin())
        here = self._place + self._beyond(q)
        last = len(self._setpoints) - 1
        if here + cycles >= last:
            return self.end - q
        on_path = self._at(here)
        # a brake of the gate is straight and deviates slightly from the path
        back = min(1.0, cycles / TAKEN_BACK_CYCLES) * (on_path - q)
        displacement: Array = self._at(here + cycles) - on_path + back
        return displacement

    def _beyond(self, q: Array) -> float:
        """How far a configuration is beyond the nearest setpoint, in cycles, from -0.5 to 0.5."""
        place, last = self._place, len(self._setpoints) - 1
        for after, sign in ((min(place + 1, last), 1.0), (max(place - 1, 0), -1.0)):
            way = self._setpoints[after] - self._setpoints[place]
            length = float(way @ way)
            share = float(way @ (q - self._setpoints[place])) / length if length > 0.0 else 0.0
            if share > 0.0:
                return sign * min(share, 0.5)
        return 0.0

    def _at(self, place: float) -> Array:
        place = max(0.0, place)
        before = int(place)
        after = min(before + 1, len(self._setpoints) - 1)
        share = place - before
        point: Array = (1.0 - share) * self._setpoints[before] + share * self._setpoints[after]
        return point
