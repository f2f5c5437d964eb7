"""Horizon and costs of the courses that an escape chooses among."""

from __future__ import annotations

from typing import NamedTuple


class EscapeGains(NamedTuple):
    """Gains of the plan; costs are per step of the horizon unless said otherwise.

    Attributes:
        step_s: time between two steps of a course [s].
        steps: how many of them are looked ahead.
        rivals: new courses that are tried in each cycle; each costs the same time at most.
        range_m: clearance from the attacker from which on it costs nothing [m].
        near: cost at zero clearance; it grows with the square of the shortfall to `range_m`.
        close_m: clearance below which it costs `close` more, in proportion [m].
        close: at no clearance.
        contact_m: clearance below which it counts as a contact: what the model cannot tell from one [m].
        contact: of a contact, and of each step after it: what has been hit is hit.
        view_rad: view angle error from which on it costs [rad].
        askew: per rad of a greater error, and no more than for half a rad.
        own_m: distance that the arm keeps from itself and from the structure [m].
        own: where it touches them, in proportion to the shortfall.
        margin: part of a joint's range within which its limit costs at the end.
        limit: of a joint that ends at its limit, once.
        inner_m: clearance of the attacker from the bodies that cannot get out of the way, from which on it costs
            nothing at the end [m].
        inner: at none, once; it grows with the square of the shortfall.
        distance: per squared m of the view distance's error at the end, once.
        better: a rival takes over if it costs less than this part of the course that is held.
        acts_above: cost of the best course from which on it leads the arm.
        led_evasion_weight, led_weight: of the programme's rows while it leads: of each joint that it leads, and of
            distance and joint margin, which the course has weighed already.
    """

    step_s: float = 0.08
    steps: int = 25
    rivals: int = 60
    range_m: float = 0.35
    near: float = 3.0
    close_m: float = 0.12
    close: float = 10.0
    contact_m: float = 0.03
    contact: float = 60.0
    view_rad: float = 0.012
    askew: float = 10.0
    own_m: float = 0.02
    own: float = 10.0
    margin: float = 0.12
    limit: float = 0.6
    inner_m: float = 0.8
    inner: float = 30.0
    distance: float = 0.3
    better: float = 0.93
    acts_above: float = 0.3
    led_evasion_weight: float = 3e-2
    led_weight: float = 1e-4
