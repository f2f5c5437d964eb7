"""Every gain says where it comes from, and its unit agrees with its name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from deltaq_controllers.camera.clear_view import SightGains
from deltaq_controllers.camera.escape.rollout import EscapeGains
from deltaq_controllers.camera.gains import FollowerGains
from deltaq_controllers.camera.qp_problem import QpGains
from deltaq_controllers.leader.scripted import STICK_ACCELERATION_M_S2
from reference_pages.gain_sources import ESCAPE, FOLLOWER, QP, SIGHT, GainSource

TABLES = pytest.mark.parametrize(
    ("gains", "sources"),
    [(FollowerGains, FOLLOWER), (QpGains, QP), (EscapeGains, ESCAPE), (SightGains, SIGHT)],
)
UNITS = {
    "_m": "m",
    "_s": "s",
    "_m2": "m²/rad²",
    "_m_s": "m/s",
    "_m_s2": "m/s²",
    "_rad": "rad",
    "_rad_s2": "rad/s²",
}


@TABLES
def test_every_gain_has_a_source_and_no_source_is_of_a_gain_that_is_gone(
    gains: Any, sources: dict[str, GainSource]
) -> None:
    assert tuple(sources) == gains._fields
    assert all(all(source) for source in sources.values())


@TABLES
def test_a_unit_in_a_name_is_that_of_the_table(gains: Any, sources: dict[str, GainSource]) -> None:
    for name in gains._fields:
        endings = sorted((end for end in UNITS if name.endswith(end)), key=len)
        if endings:
            assert sources[name].unit == UNITS[endings[-1]], name


def test_values_that_are_said_to_follow_from_others_do() -> None:
    gains, qp = FollowerGains(), QpGains()
    assert gains.emergency_on_m < gains.emergency_off_m
    assert gains.max_step_s == gains.horizon_s == pytest.approx(5 * 0.012)
    assert qp.others_share < qp.barrier_share
    assert qp.barrier_price > qp.reserve_price > qp.angle_weight
    shared = ("limit_scale", "spin_rad_s2")
    assert [getattr(qp, name) for name in shared] == [getattr(gains, name) for name in shared]
    assert qp.others_brake_m_s2 == STICK_ACCELERATION_M_S2
    assert (qp.evasion_range_m, qp.evasion_min_m) == (gains.repulsion_range_m, gains.repulsion_min_m)


def test_the_documented_costs_of_an_escape_hold() -> None:
    gains = EscapeGains()
    assert gains.steps * gains.step_s == pytest.approx(2.0)
    assert gains.near < gains.close < gains.contact
    assert gains.contact > max(gains.near + gains.close, 0.5 * gains.askew, gains.own)
    assert gains.view_rad < np.deg2rad(1.0)
    assert gains.led_weight < 0.01 * gains.led_evasion_weight
