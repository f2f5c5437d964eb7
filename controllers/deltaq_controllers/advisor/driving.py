"""Driving a path through the gate: at what time to be where, and one increment a cycle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.blocking import BlockingRobot
from deltaq_protocol.messages import Outcome, Verdict

Array = NDArray[np.float64]

SHARE = 0.6
"""Of the joints' speed and acceleration limits; the gate's own bounds are never reached."""

LOOK_AHEAD = 40
"""Cycles of the path among which the robot's own place is looked for."""

ARRIVED = 1e-9
"""A robot is at the path's end within this, in every joint [rad or m]."""

PATIENCE_CYCLES = 200
"""Cycles in a row in which nothing is admitted, after which driving is given up."""


def timed(path: Array, tracker: ConstraintTracker, cycle_s: float) -> Array:
    """Where to be in every cycle, the hands exactly where they are at the path's start.

    Over the path's length s the speed is bounded by the joints' speeds, `|q'| v <= share v_max`, and their
    accelerations, half of which go to bends, `|q''| v^2`, and half to speeding up and slowing down, `|q'| dv/dt`.

    Args:
        path: (P, n) configurations of a self-motion.
        tracker: of the robot.
        cycle_s: sample time.

    Returns:
        (T, n) setpoints from the path's start to its end, at rest at both.
    """
    setpoints = _timed(path, tracker.robot, cycle_s)
    base = setpoints[:, tracker.base]
    held = tracker.track(base, tracker.hands(path[0]), setpoints)
    # the ends are where the robot is and shall be, to the bit
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
    fastest = (SHARE * robot.max_velocity / np.maximum(slope, 1e-9)).min(axis=1)
    pull = (0.5 * SHARE * robot.max_acceleration / np.maximum(slope, 1e-9)).min(axis=1)
    bend = np.abs(np.diff(signed, axis=0)) / (0.5 * (lengths[1:] + lengths[:-1]))[:, None]
    at_bend = np.sqrt((0.5 * SHARE * robot.max_acceleration / np.maximum(bend, 1e-9)).min(axis=1))
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


class PathController:
    """Follows a timed path: where the gate lets it less far, it goes on from where the robot is.

    Args:
        setpoints: (T, n) of `timed`.

    Attributes:
        finished: the robot stands at the end.
    """

    def __init__(self, setpoints: Array) -> None:
        self._setpoints = setpoints
        self._place = 0
        self.finished = False

    def increment(self, view: View) -> Array:
        """The increment for this cycle; zero once the robot stands at the end."""
        q = view.own.q_cmd
        window = self._setpoints[self._place : self._place + LOOK_AHEAD]
        self._place += int(np.abs(window - q).max(axis=1).argmin())
        following = self._setpoints[min(self._place + 1, len(self._setpoints) - 1)]
        self.finished = bool(np.abs(self._setpoints[-1] - q).max() < ARRIVED)
        increment: Array = following - q
        return increment


def drive_path(
    robot: BlockingRobot, controller: PathController, on_verdict: Callable[[Verdict], None] = lambda _: None
) -> Counter[str]:
    """Drive a path to its end through the gate of a running cell.

    Args:
        robot: leased.
        controller: of the path, which begins where the robot is.
        on_verdict: called with every verdict.

    Returns:
        How many increments had which outcome.

    Raises:
        ControllerError: nothing was admitted for too long.
        RefusedError: the lease was lost.
    """
    outcomes: Counter[str] = Counter()
    verdict: Verdict | None = None
    stuck = 0
    for state in robot.states():
        own = RobotView.from_state(state)
        if verdict is not None and verdict.dq and verdict.cycle >= state.cycle:
            own = own.after(verdict.cycle, np.array(verdict.dq))
        increment = controller.increment(View(own))
        if controller.finished:
            return outcomes
        verdict = robot.move(increment.tolist())
        outcomes[verdict.outcome] += 1
        on_verdict(verdict)
        stuck = 0 if verdict.outcome in (Outcome.ADMITTED, Outcome.SCALED) else stuck + 1
        if stuck > PATIENCE_CYCLES:
            why = ", ".join(f"{reason.code} {reason.what}".strip() for reason in verdict.reasons)
            raise ControllerError(
                f"{robot.name} has not been let on for {stuck} cycles: {why or verdict.outcome}; "
                "see `deltaq status` for its phase, and advise again from where it stands"
            )
    return outcomes
