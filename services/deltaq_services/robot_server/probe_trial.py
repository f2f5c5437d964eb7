"""One trial of a KRC's mode of corrections: the pulse that it adds to the setpoint, and the evaluation of samples.

A constant correction is a place where RSI is absolute, `RSI_ON(#ABSOLUTE)`, and a constant speed where it is relative.
So each trial adds a short pulse to the setpoint, waits until the drives have followed, and then adds its negative:

| the KRC | after the pulse | after its negative | area below the curve |
| --- | --- | --- | --- |
| is absolute | back where it was | back where it was | that of the pulse, and of its negative |
| adds up | displaced by the pulse's sum | back where it was | is not looked at |
| moves nothing | where it was | where it was | none |

Drives smear a pulse, but linear ones of gain one keep its area, so their lag does not matter if it ends within a
window. A joint that sags, or is noisy, does not mirror its motion in the second half; such a trial has no result,
and is repeated.

The area that has come in by some time after a pulse is the share of a step that has arrived by then: the same trial
measures the lag of each joint (`deltaq_cell.drive_lag`). A pulse lasts some cycles: a lag reads long by up to half of
it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_cell.drive_lag import REMAINDER, AxisLag, axis_lag
from deltaq_protocol.arrays import Array

PROBE_RAD = math.radians(0.03)
PROBE_M = 0.03e-3
"""Sum of a pulse: how far a KRC that adds up is displaced by it."""

SHARE_OF_TOLERANCE = 0.6
"""Of its tracking tolerance no joint is displaced by more. A robot may be that tolerance off its path without being
held, so the distances that the gate keeps pay for it already."""

_REST_S = 0.036
"""How long samples before and after a response tell where the robot rests; at least three of them."""

_BACK = 0.25
"""Share of a pulse's sum by which a joint that is back where it was may be off."""

_SEEN = 0.5
"""Share of a pulse that has to be seen; and no more than the inverse of it."""

_UNRESOLVED = 2 * REMAINDER
"""A response that is known to no more than this share of the pulse does not tell the lag."""


class Mode(StrEnum):
    """How a KRC takes corrections."""

    UNKNOWN = "unknown"
    ABSOLUTE = "absolute"
    RELATIVE = "relative"
    """It adds them up."""
    ADRIFT = "adrift"
    """The robot moves though its correction rests."""


@dataclass(frozen=True, slots=True)
class Trial:
    """The cycles of a trial: rest, a pulse and its response, the negative pulse and its response.

    The first value of a pulse is sent in reply to the last sample at rest, so it is measured from the next one on.

    Attributes:
        rest: samples that tell where the robot rests.
        pulse: of a pulse.
        window: from the beginning of one pulse to the beginning of the next.
    """

    rest: int
    pulse: int
    window: int

    @classmethod
    def of(cls, pulse: int, lag_cycles: int, cycle_s: float) -> Trial:
        """A trial for drives with at most this lag."""
        rest = max(3, math.ceil(_REST_S / cycle_s))
        return cls(rest, pulse, pulse + lag_cycles + rest)

    @property
    def begins(self) -> tuple[int, int]:
        """First sample of either response."""
        return self.rest + 1, self.rest + 1 + self.window


def joint_modes(samples: Array, trial: Trial, within: int) -> list[Mode]:
    """The mode of the KRC that each joint's motion shows.

    Args:
        samples: (rest + 2 window + 1, n) measured in each cycle of a trial, in units of the pulses' sums.
        trial: its cycles.
        within: cycles of a window within which a response is looked for; noise hides less of it in fewer.

    Returns:
        n modes, UNKNOWN for a joint that agrees with neither.
    """
    steps, areas = [], []
    for begin, sign in zip(trial.begins, (1.0, -1.0), strict=True):
        end = begin + within
        before = samples[begin - trial.rest : begin].mean(axis=0)
        after = samples[end - trial.rest : end].mean(axis=0)
        steps.append(sign * (after - before))
        # above a straight line from rest to rest, so that a slow drift has no area
        areas.append(sign * (samples[begin:end].sum(axis=0) - within * (before + after) / 2))
    adds_up = np.minimum(*steps) > _SEEN
    back = np.maximum(np.abs(steps[0]), np.abs(steps[1])) < _BACK
    follows = (np.minimum(*areas) > _SEEN) & (np.maximum(*areas) < 1 / _SEEN)
    return [
        Mode.RELATIVE if relative else Mode.ABSOLUTE if absolute else Mode.UNKNOWN
        for relative, absolute in zip(adds_up, back & follows, strict=True)
    ]


def joint_lags(samples: Array, cycles: Array, trial: Trial, cycle_s: float) -> list[AxisLag | None]:
    """The lag of each joint, for a KRC with absolute corrections.

    Args:
        samples: as for `joint_modes`.
        cycles: (rest + 2 window + 1,) cycle of each sample; lost telegrams leave gaps, which are interpolated.
        trial: its cycles; a step is taken to be sent in the middle of a pulse.
        cycle_s: sample time.

    Returns:
        n lags; None for a joint whose noise, or whose telegram's decimals, hide it. They are infinite where the two
        responses differ: one was still on its way when the next pulse came, or something else moved the joint.
    """
    halves, evenly = [], np.arange(1, trial.window + 1)
    for begin, sign in zip(trial.begins, (1.0, -1.0), strict=True):
        seen = slice(begin - trial.rest, begin + trial.window)
        times = cycles[seen] - cycles[begin - 1]
        moved = np.array([np.interp(evenly, times, joint) for joint in samples[seen].T])
        before, after = samples[seen][: trial.rest].mean(axis=0), moved[:, -trial.rest :].mean(axis=1)
        moved -= before[:, np.newaxis] + np.outer(after - before, evenly / trial.window)
        halves.append(sign * np.cumsum(moved, axis=1))
    differ = np.abs(halves[0] - halves[1]).max(axis=1) / 2
    ends = (trial.rest + 1, *(begin + trial.window for begin in trial.begins))
    noise = np.sqrt(np.mean([samples[end - trial.rest : end].var(axis=0, ddof=1) for end in ends], axis=0))
    # the mean of both halves has a quarter of the difference between first and last rest at every sample
    sums = trial.window * math.sqrt(2.0 / trial.rest) / 4.0
    lags: list[AxisLag | None] = []
    for joint, arrived in enumerate((halves[0] + halves[1]) / 2):
        decimal = float(np.diff(np.unique(samples[:, joint])).min(initial=1.0))
        noisy = 3.0 * max(float(noise[joint]), decimal / math.sqrt(12.0)) * sums + decimal
        first_s = (1.5 - trial.pulse // 2) * cycle_s  # a sample is the mean over half a cycle to either side
        lag = axis_lag(arrived, first_s, cycle_s, max(float(differ[joint]) + decimal, noisy))
        if differ[joint] > max(_UNRESOLVED, 4.0 * noisy):
            lag = replace(lag, settled_s=math.inf, least_s=math.inf)
        lags.append(None if noisy > _UNRESOLVED else lag)
    return lags


def pulse_offsets(robot: RobotDescription, cycle_s: float) -> Array:
    """(k, n) offsets of a trial's first pulse in each cycle [rad or m]; the second pulse subtracts them."""
    size = pulse_sums(robot)
    return triangle(size, robot.max_acceleration * cycle_s**2)[:, np.newaxis] * size


def pulse_sums(robot: RobotDescription) -> Array:
    """(n,) sum of a pulse: how far a KRC that adds up displaces each joint [rad or m]."""
    largest = np.array([PROBE_RAD if unit == "rad" else PROBE_M for unit in robot.units])
    size: Array = np.minimum(largest, SHARE_OF_TOLERANCE * robot.tracking_tolerance)
    return size


def triangle(size: Array, max_dv: Array) -> Array:
    """The shortest triangular pulse of sum 1 for joints with these pulse sizes (n,) and acceleration limits (n,)."""
    # at its peak the speed turns from one step up to one step down: two steps, each of size / half**2
    half = max(1, math.ceil(math.sqrt(float(np.max(2.0 * size / max_dv)))))
    return (half - np.abs(np.arange(1 - half, half))) / half**2
