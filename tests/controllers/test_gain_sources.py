"""Every gain says where it comes from, and its unit agrees with its name."""

from typing import Any

import pytest

from deltaq_controllers.camera.clear_view import SightGains
from deltaq_controllers.camera.escape.rollout import EscapeGains
from deltaq_controllers.camera.law import FollowerGains
from deltaq_controllers.camera.qp_problem import QpGains
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
def test_gains_and_sources_correspond(gains: Any, sources: dict[str, GainSource]) -> None:
    assert tuple(sources) == gains._fields
    assert all(all(source) for source in sources.values())


@TABLES
def test_a_unit_in_a_gain_name_agrees_with_the_table(gains: Any, sources: dict[str, GainSource]) -> None:
    for name in gains._fields:
        endings = sorted((end for end in UNITS if name.endswith(end)), key=len)
        if endings:
            assert sources[name].unit == UNITS[endings[-1]], name
