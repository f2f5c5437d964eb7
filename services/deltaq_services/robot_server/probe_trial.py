"""One trial of how a KRC takes corrections: what it adds to the setpoint, and what the measured samples tell.

A constant correction is a place where RSI is absolute, `RSI_ON(#ABSOLUTE)`, and a constant speed where it is relative.
So each trial adds a short pulse to the setpoint, waits until the drives have followed, and then adds its negative:

| the KRC | after the pulse | after its negative | area below the curve |
| --- | --- | --- | --- |
| is absolute | back where it was | back where it was | that of the pulse, and of its negative |
| adds up | displaced by the pulse's sum | back where it was | is not looked at |
| moves nothing | where it was | where it was | none |

Drives smear a pulse, but linear ones of gain one keep its area, so that it does not matter how they lag as long as they
are done within a window. A joint that sags, or is noisy, does not do the same with its sign turned in the second half;
such a trial tells nothing, and there is another.
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array

PROBE_RAD = math.radians(0.03)
PROBE_M = 0.03e-3
"""Sum of a pulse: how far a KRC that adds up is displaced by it."""

SHARE_OF_TOLERANCE = 0.1
"""Of its tracking tolerance no joint is displaced by more. A robot may be that tolerance off its path without being
held, so the distances that the gate keeps pay for it already."""

AT_REST = 3
"""Samples at the end of a window that tell where the robot has come to rest."""

_BACK = 0.25
"""Share of a pulse's sum by which a joint that is back where it was may be off."""

_SEEN = 0.5
"""Share of a pulse that has to be seen; and no more than the inverse of it."""


class Mode(StrEnum):
    """How a KRC takes corrections."""

    UNKNOWN = "unknown"
    ABSOLUTE = "absolute"
    RELATIVE = "relative"
    """It adds them up."""
    ADRIFT = "adrift"
    """The robot moves though its correction rests."""


def joint_modes(samples: Array, window: int) -> list[Mode]:
    """The mode of the KRC that each joint's motion shows.

    Args:
        samples: (3 + 2 window + 1, n) measured in each cycle of a trial, in units of the pulses' sums. The first value
            of the pulse was sent in reply to sample 3, that of its negative a window later.
        window: number of samples from the beginning of one pulse to the beginning of the next.

    Returns:
        n modes, UNKNOWN for a joint that agrees with neither.
    """
    begins = (AT_REST + 1, AT_REST + 1 + window)
    rest = [samples[end - AT_REST : end].mean(axis=0) for end in (*begins, begins[1] + window)]
    steps = (rest[1] - rest[0], rest[1] - rest[2])
    # above straight lines from rest to rest, so that a slow drift has no area
    areas = [
        sign * (samples[begin : begin + window].sum(axis=0) - window * (rest[half] + rest[half + 1]) / 2)
        for half, (begin, sign) in enumerate(zip(begins, (1.0, -1.0), strict=True))
    ]
    adds_up = np.minimum(*steps) > _SEEN
    back = np.maximum(np.abs(steps[0]), np.abs(steps[1])) < _BACK
    follows = (np.minimum(*areas) > _SEEN) & (np.maximum(*areas) < 1 / _SEEN)
    return [
        Mode.RELATIVE if relative else Mode.ABSOLUTE if absolute else Mode.UNKNOWN
        for relative, absolute in zip(adds_up, back & follows, strict=True)
    ]


def pulse_offsets(robot: RobotDescription, cycle_s: float) -> Array:
    """What a trial's first pulse adds to the setpoint, cycle by cycle (k, n) [rad or m]; its second subtracts it."""
    size = pulse_sums(robot)
    return triangle(size, robot.max_acceleration * cycle_s**2)[:, np.newaxis] * size


def pulse_sums(robot: RobotDescription) -> Array:
    """(n,) sum of a pulse: how far a KRC that adds up displaces each joint [rad or m]."""
    largest = np.array([PROBE_RAD if unit == "rad" else PROBE_M for unit in robot.units])
    size: Array = np.minimum(largest, SHARE_OF_TOLERANCE * robot.tracking_tolerance)
    return size


def triangle(size: Array, max_dv: Array) -> Array:
    """A triangle whose sum is one, as short as joints of these sizes (n,) and limits of acceleration (n,) allow."""
    # at its peak the speed turns from one step up to one step down: two steps, each of size / half**2
    half = max(1, math.ceil(math.sqrt(float(np.max(2.0 * size / max_dv)))))
    return (half - np.abs(np.arange(1 - half, half))) / half**2
