"""`deltaq krc lag`: the increments that measure the lag of each axis, and its evaluation from states.

Pure: no clock, no I/O. One axis after the other makes a short step, rests, steps back, rests, and then goes out and
back at a tenth of its speed. A step of three cycles at 12 ms shows how a setpoint arrives; the sweep shows how far a
moving axis trails.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.drive_lag import LONGEST_S, AxisLag, axis_lag
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import RobotState, RobotSummary

_STEP_S = 0.018
"""Half the duration of a step."""
_MOST_STEP = {"rad": math.radians(0.5), "m": 1e-3}
_SWEEP = {"rad": math.radians(3.0), "m": 0.03}
_SPEED_SHARE = 0.1
_ACCELERATION_SHARE = 0.5
_REST_S = 2 * LONGEST_S


@dataclass(frozen=True)
class SweepMotion:
    """One motion of one axis.

    Attributes:
        axis: its number, from 0.
        is_step: a step, not a sweep.
        increments: (k,) cycle by cycle, rest included [rad or m].
    """

    axis: int
    is_step: bool
    increments: Array


def motions(summary: RobotSummary, q: Sequence[float], cycle_s: float) -> Iterator[SweepMotion]:
    """The motions of a measurement that begins at `q` (n,) [rad or m]; each axis ends where it began."""
    for axis, unit in enumerate(summary.units):
        inwards = 1.0 if q[axis] < (summary.lower[axis] + summary.upper[axis]) / 2 else -1.0
        max_dv = _ACCELERATION_SHARE * summary.max_acceleration[axis] * cycle_s**2
        half = max(2, math.ceil(_STEP_S / cycle_s))
        step = _triangle(min(half**2 * max_dv, _MOST_STEP[unit]), half)
        top = _SPEED_SHARE * summary.max_velocity[axis] * cycle_s
        up = np.arange(max_dv, top, max_dv)
        cruise = np.full(max(1, round((_SWEEP[unit] - 2 * up.sum()) / top)), top)
        sweep = np.concatenate([up, cruise, up[::-1]])
        rest = np.zeros(math.ceil(_REST_S / cycle_s))
        for is_step, motion in ((True, step), (False, sweep)):
            for sign in (inwards, -inwards):
                yield SweepMotion(axis, is_step, np.concatenate([sign * motion, rest]))


def _triangle(distance: float, half: int) -> Array:
    return distance * (half - np.abs(np.arange(1 - half, half))) / half**2


@dataclass(frozen=True)
class DrivenSweep:
    """The states of one motion.

    Attributes:
        axis: which moved.
        is_step: a step, not a sweep.
        cycles: (k,) of the states.
        q_cmd, q: (k,) setpoint sent in each cycle, and position measured at its begin [rad or m].
    """

    axis: int
    is_step: bool
    cycles: Array
    q_cmd: Array
    q: Array

    @classmethod
    def of(cls, motion: SweepMotion, states: Sequence[RobotState]) -> DrivenSweep:
        """From the states since the motion began."""
        cycles = np.array([state.cycle for state in states], dtype=float)
        q_cmd, q = (
            np.array([getattr(state, name)[motion.axis] for state in states]) for name in ("q_cmd", "q")
        )
        return cls(motion.axis, motion.is_step, cycles, q_cmd, q)


@dataclass(frozen=True)
class MeasuredAxis:
    """Measurements of one axis.

    Attributes:
        lag: of its steps.
        moving_s: by how much it trailed in its sweeps.
    """

    lag: AxisLag
    moving_s: float


def measured_axis(courses: Sequence[DrivenSweep], cycle_s: float) -> MeasuredAxis:
    """The lag of one axis, from two steps and two sweeps.

    Raises:
        ValueError: an axis did not move, or did not follow its setpoints.
    """
    steps = [_arrived(course) for course in courses if course.is_step]
    count = min(len(share) for _, share in steps)
    there, back = (share[:count] for _, share in steps)
    first = float(np.mean([first for first, _ in steps]))
    differ = float(np.abs(there - back).max()) / 2
    trails = [_trails(course) for course in courses if not course.is_step]
    return MeasuredAxis(
        axis_lag((there + back) / 2, first * cycle_s, cycle_s, differ), float(np.mean(trails)) * cycle_s
    )


def _arrived(course: DrivenSweep) -> tuple[float, Array]:
    """Time of the first value after the middle of the step [cycles], and which share has arrived, cycle by cycle."""
    begin, end = course.q[0], course.q_cmd[-1]
    distance = end - course.q_cmd[0]
    if abs(course.q[-1] - begin - distance) > 0.25 * abs(distance):
        raise ValueError(f"it moved by {course.q[-1] - begin:.6f} instead of {distance:.6f} (rad or m)")
    evenly = np.arange(course.cycles[0] + 1, course.cycles[-1] + 1)
    q = np.interp(evenly, course.cycles, course.q)
    return float(evenly[0]) + 0.5 - _middle(course), (q - begin) / distance  # a sample is the mean around it


def _middle(course: DrivenSweep) -> float:
    sent = np.diff(course.q_cmd)
    cycles = (course.cycles[1:] + course.cycles[:-1] + 1) / 2  # where states were lost, the middle of the gap
    return float((cycles * sent).sum() / sent.sum())


def _trails(course: DrivenSweep) -> float:
    """Mean delay over a motion from rest to rest [cycles]."""
    evenly = np.arange(course.cycles[0], course.cycles[-1] + 1)
    q, q_cmd = (np.interp(evenly, course.cycles, values) for values in (course.q, course.q_cmd))
    off = q_cmd[0] - q[0]
    return float((q_cmd - q - off).sum() / (q_cmd[-1] - q_cmd[0]))
