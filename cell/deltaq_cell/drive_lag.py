"""Lag of a robot's drives: its definition, its measurement from a response, and the gate's assumption.

Drives reach a setpoint some time after it was sent. For linear drives the share `S(t)` of a step of the setpoint has
arrived at the time `t` after it was sent. The gate presumes that every measured configuration lies in the hull of the
setpoints of the last `gate.servo_lag_s`, up to the tracking tolerance. It is a mean of earlier setpoints, and older
setpoints than those contribute the share `1 - S(servo_lag_s)`. So neither the mean delay nor the time to half a step
shows whether this assumption holds; the settled lag does:

    settled lag: the least T with |1 - S(t)| <= REMAINDER for every t >= T

It includes the cycle in which the setpoint travels to the drives, their dead time, their response, and overshoot by
more than the remainder.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.description.robot import ServoLag
from deltaq_protocol.arrays import Array

REMAINDER = 0.05
"""Share of a step that may be missing, or too much, once the drives count as settled. At a setpoint's largest speed the
drives trail the hull by the time integral of what is missing: 1.5 ms of travel for a response of 50 ms."""

LONGEST_S = 0.3
"""Lags up to this are measured."""


@dataclass(frozen=True, slots=True)
class AxisLag:
    """Lag of one axis, from the sending of a setpoint to the telegram that measures it.

    Attributes:
        dead_s: until the share REMAINDER of a step has arrived.
        half_s: until half of it has.
        mean_s: mean delay: by how much a ramp lags behind.
        settled_s: until it has arrived up to REMAINDER, and stays so; infinite if it does not.
        least_s: the same as far as the measurement proves it: with its uncertainty on top of REMAINDER.
        overshoot: fraction of a step by which the axis overshoots.
    """

    dead_s: float
    half_s: float
    mean_s: float
    settled_s: float
    least_s: float
    overshoot: float


def axis_lag(arrived: Array, first_s: float, cycle_s: float, uncertainty: float = 0.0) -> AxisLag:
    """The lag that a response shows.

    Args:
        arrived: (k,) share of a step that has arrived, cycle by cycle; zero before.
        first_s: time of the first value after the step was sent.
        cycle_s: sample time.
        uncertainty: of the values.
    """
    error = np.abs(1.0 - arrived)
    return AxisLag(
        dead_s=_rises_to(REMAINDER, arrived, first_s, cycle_s),
        half_s=_rises_to(0.5, arrived, first_s, cycle_s),
        mean_s=first_s + cycle_s * (float((1.0 - arrived).sum()) - 0.5),
        settled_s=_falls_to(REMAINDER, error, first_s, cycle_s),
        least_s=_falls_to(REMAINDER + uncertainty, error, first_s, cycle_s),
        overshoot=max(0.0, float(arrived.max()) - 1.0),
    )


def _rises_to(share: float, values: Array, first_s: float, cycle_s: float) -> float:
    reached = np.flatnonzero(values >= share)
    if not reached.size:
        return math.inf
    after = int(reached[0])
    before, value = float(values[after - 1]) if after else 0.0, float(values[after])
    return first_s + cycle_s * (after - 1 + (share - before) / (value - before))


def _falls_to(share: float, errors: Array, first_s: float, cycle_s: float) -> float:
    outside = np.flatnonzero(errors > share)
    if not outside.size:
        return first_s - cycle_s
    last = int(outside[-1])
    if last + 1 == len(errors):
        return math.inf
    part = (float(errors[last]) - share) / float(errors[last] - errors[last + 1])
    return first_s + cycle_s * (last + part)


def emulated_lag(lag: ServoLag, cycle_s: float) -> AxisLag:
    """The lag of an emulated robot: its KRC takes a reply at a cycle's end, its drives go there in the next."""
    return modelled_lag(lag, 2.0 * cycle_s)


def modelled_lag(lag: ServoLag, travel_s: float) -> AxisLag:
    """The lag of drives that a setpoint reaches after `travel_s`."""
    step_s = 0.0005
    times = step_s * np.arange(1, round(4.0 * LONGEST_S / step_s))
    error = [transition(time_s, lag.natural_frequency_rad_s, lag.damping)[0, 0] for time_s in times]
    # samples are means over the steps between them, as in a measured response
    return axis_lag(1.0 - np.array(error), travel_s + lag.dead_time_s + step_s, step_s)


def transition(duration_s: float, frequency_rad_s: float, damping: float) -> Array:
    """(2, 2) matrix that carries (e, e') of `e'' + 2 z w e' + w^2 e = 0` over `duration_s`."""
    t, w, z = duration_s, frequency_rad_s, damping
    decay = math.exp(-z * w * t)
    if abs(z - 1.0) < 1e-6:
        cosine, sine_over_frequency = 1.0, t
    elif z < 1.0:
        wd = w * math.sqrt(1.0 - z * z)
        cosine, sine_over_frequency = math.cos(wd * t), math.sin(wd * t) / wd
    else:
        wd = w * math.sqrt(z * z - 1.0)
        # cosh and sinh times the decay, without overflow for a damping far above 1
        slow, fast = math.exp((wd - z * w) * t), math.exp(-(wd + z * w) * t)
        decay, cosine, sine_over_frequency = 1.0, (slow + fast) / 2.0, (slow - fast) / (2.0 * wd)
    return decay * np.array(
        [
            [cosine + z * w * sine_over_frequency, sine_over_frequency],
            [-w * w * sine_over_frequency, cosine - z * w * sine_over_frequency],
        ]
    )


def least_servo_lag_s(settled_s: float, cycle_s: float) -> float:
    """The least `gate.servo_lag_s` for drives of that lag: whole cycles, and one to spare."""
    if math.isinf(settled_s):
        return math.inf
    return round((math.ceil(settled_s / cycle_s - 1e-6) + 1) * cycle_s, 6)


def lag_fault(axes: Sequence[str], settled_s: Sequence[float], presumed_s: float, cycle_s: float) -> str:
    """The axis that lags most, where that is more than the gate presumes, and the remedy; empty if none does."""
    axis, lag_s = max(zip(axes, settled_s, strict=True), key=lambda one: one[1], default=("", 0.0))
    if lag_s <= presumed_s:
        return ""
    presumed = f"the gate presumes {presumed_s * 1e3:.0f}"
    if math.isinf(lag_s):
        longest = f"axis {axis} lags more than {LONGEST_S * 1e3:.0f} ms, {presumed}"
        return f"{longest}: a robot with so long a lag is not driven"
    least_s = least_servo_lag_s(lag_s, cycle_s)
    return f"axis {axis} lags {lag_s * 1e3:.0f} ms, {presumed}: set gate.servo_lag_s to at least {least_s:g}"
