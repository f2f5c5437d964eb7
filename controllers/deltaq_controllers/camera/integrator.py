"""One increment from a velocity field: Bjerkeng et al., III-F.

The field is integrated by the classical Runge-Kutta method over a virtual horizon, longer than the cycle, so
that the increment reaches as far towards the optimum as allowed. Differences from the print, see the errata:
the start is the commanded reference, and every step is bounded to a fraction of the increment cap, since
near contact the field is stiff. The horizon replaces the CPU time, so that the result does not hang on
how fast the machine is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array

VectorField = Callable[[Array], Array]

_STILL = 1e-300
"""A joint that moves by less never reaches its cap [rad or m]."""


def runge_kutta_step(field: VectorField, q: Array, rates: Array, step_s: float) -> Array:
    """Displacement over one classical Runge-Kutta step.

    Args:
        field: velocity of each configuration.
        q: (n,) start.
        rates: (n,) `field(q)`, which the caller has at hand.
        step_s: length of the step [s].
    """
    k2 = field(q + (0.5 * step_s) * rates)
    k3 = field(q + (0.5 * step_s) * k2)
    k4 = field(q + step_s * k3)
    return _weighted_mean(rates, k2, k3, k4, step_s)


@compiled
def _weighted_mean(k1: Array, k2: Array, k3: Array, k4: Array, step_s: float) -> Array:
    """Displacement by the four stages of a step."""
    return (step_s / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)


@compiled
def largest_share(rates: Array, cap: Array) -> float:
    """The largest rate of a joint by its cap [1/s]."""
    return float((np.abs(rates) / cap).max())


@compiled
def share_inside(start: Array, step: Array, cap: Array) -> float:
    """Largest s in [0, 1] with `|start + s step| <= cap` for every joint; `start` lies inside."""
    room = cap - np.sign(step) * start
    return min(1.0, float((room / np.maximum(np.abs(step), _STILL)).min()))


def integrate(
    field: VectorField,
    q: Array,
    horizon_s: float,
    max_step_s: float,
    cap: Array,
    max_share: float = 0.2,
    max_steps: int = 40,
) -> Array:
    """Displacement along the field over the horizon, or to where the first joint reaches its cap.

    Args:
        field: velocity of each configuration [rad/s or m/s].
        q: (n,) start, the commanded reference [rad or m].
        horizon_s: virtual time to integrate over [s].
        max_step_s: longest step [s].
        cap: (n,) largest increment [rad or m].
        max_share: fraction of the cap that one step may cover.
        max_steps: number of steps after which the integration ends.

    Returns:
        (n,) increment [rad or m].
    """
    moved = np.zeros_like(q)
    left_s = horizon_s
    for _ in range(max_steps):
        rates = field(q + moved)
        fastest = largest_share(rates, cap)
        step_s = min(left_s, max_step_s)
        if step_s * fastest > max_share:
            step_s = max_share / fastest
        step = runge_kutta_step(field, q + moved, rates, step_s)
        share = share_inside(moved, step, cap)
        moved = moved + share * step
        left_s -= step_s
        if share < 1.0 or left_s <= 1e-9 * horizon_s:
            break
    return moved
