"""Gains of the camera follower."""

from __future__ import annotations

from typing import NamedTuple

from deltaq_controllers.redundancy import DEGREES


class FollowerGains(NamedTuple):
    """Gains of the follower. Rates are per second of the virtual horizon.

    Attributes:
        direction: k_p of (9) [1/s].
        distance: rate of the view distance error [1/s]; k of (14) is this over the mobility [m^2/rad^2].
        min_mobility_m2: mobility below which the view distance is given up more and more [m^2/rad^2].
        roll: k_c of (15) [1/s].
        repulsion: eta of (12) as corrected [m^3 rad/s].
        repulsion_range_m: rho_0 of (12) [m].
        repulsion_min_m: clearance at which the repulsion stops growing [m].
        emergency_on_m: clearance below which (13) takes over [m].
        emergency_off_m: clearance above which (9) takes over again [m].
        limit_scale: s_w of the weights (10) [rad].
        damping: ratio of view angle to joint angle at which the damping of (7) halves the task rate.
        horizon_s: virtual horizon of one increment [s].
        max_step_s: longest Runge-Kutta step [s].
        turn_rad_s2: deceleration of the view angle that approaching the focus counts on [rad/s^2].
        zoom_m_s2: deceleration of the view distance that approaching the desired one counts on [m/s^2].
        spin_rad_s2: deceleration of the roll that levelling the picture counts on [rad/s^2].
    """

    direction: float = 30.0
    distance: float = 25.0
    min_mobility_m2: float = 0.05
    roll: float = 15.0
    repulsion: float = 2e-3
    repulsion_range_m: float = 0.3
    repulsion_min_m: float = 0.03
    emergency_on_m: float = 0.08
    emergency_off_m: float = 0.12
    limit_scale: float = DEGREES
    damping: float = 0.03
    horizon_s: float = 0.06
    max_step_s: float = 0.06
    turn_rad_s2: float = 10.0
    zoom_m_s2: float = 2.0
    spin_rad_s2: float = 30.0
