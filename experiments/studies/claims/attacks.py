"""The claims about a camera follower under attack: the paper's, and those of the controllers here in three cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from deltaq_experiments.options import Options
from studies.claims import quantities as q
from studies.claims.claim import Claim, JsonReport
from studies.claims.table import LENGTH_S

BARRIER_LESS_1_CM = 0.09
"""The programme keeps other robots 10 cm away, twice the gate's stop distance."""

FIRST_ATTACK_S = 1.0
"""By then the camera looks at its focus, and the first attack has just begun [s]."""

CELLS = ("lab", "lab-open", "lab-aside")
"""The lab; the lab without the panel, on which the attacker jams; and the same with the follower elsewhere."""

_LEADER = (q.PRESSURE, q.LEADER_MEAN, q.LEADER_PEAK)
_COLLISION = (q.CONTACTS, q.CLEARANCE, q.ANGLE, q.BELOW_1_DEG, *_LEADER, q.HELD, q.ROLL, q.SEEN)
_UNGATED = (q.CONTACTS, q.CLEARANCE, q.ANGLE, q.BELOW_1_DEG, *_LEADER, q.ROLL, q.SEEN)


def _kept_clear(least_m: float) -> Callable[[JsonReport], bool]:
    return lambda r: (
        r["contacts"] == 0 and r["clearance_m"]["robots_min"] >= least_m and r["angle_deg"]["max"] <= 1.0
    )


def _no_contact(report: JsonReport) -> bool:
    return bool(report["contacts"] == 0)


def _no_contact_and_seen(report: JsonReport) -> bool:
    return _no_contact(report) and bool(report["angle_below_1_deg_share"] >= 0.98)


def _attack(claim: str, holds: Callable[[JsonReport], bool], picture: str = "", **options: Any) -> Claim:
    usual = Options(controller="qp", settle_s=FIRST_ATTACK_S, duration_s=LENGTH_S)
    chosen = replace(usual, **options)
    return Claim("collision", chosen, claim, holds, _COLLISION if chosen.gated else _UNGATED, picture)


def _ungated(controller: str, cell: str) -> tuple[Claim, ...]:
    """Fast attacks that no gate stops; the structure does not stop them either."""
    free: dict[str, Any] = {"controller": controller, "cell": cell, "gated": False}
    claim = "no gate: no contact"
    return (
        _attack(claim, _no_contact, **free, leader_speed_m_s=0.75),
        _attack(claim, _no_contact, **free, leader_speed_m_s=0.5, target="elbow"),
        _attack(claim, _no_contact, **free, leader_speed_m_s=0.5, target="wrist"),
    )


def _gated(controller: str, cell: str) -> Claim:
    """A fast attack on the lens that the gate stops."""
    seen = "no contact, below 1° in 98 % of cycles"
    options: dict[str, Any] = {"controller": controller, "cell": cell, "leader_speed_m_s": 0.75}
    return _attack(seen, _no_contact_and_seen, **options)


_KEPT_9_CM = _kept_clear(BARRIER_LESS_1_CM)

ATTACKS = (
    _attack(
        "Fig. 11: no contact; the distance gives way, the angle does not",
        _kept_clear(0.0),
        picture="fig-11-paper",
        controller="paper",
    ),
    _attack("no contact, 9 cm kept, 1°", _KEPT_9_CM, picture="fig-11-qp"),
    _attack("attack on the wrist: no contact, 9 cm kept, 1°", _KEPT_9_CM, target="wrist"),
    _attack("attack on the lens at 0.5 m/s: no contact, 9 cm kept, 1°", _KEPT_9_CM, leader_speed_m_s=0.5),
    *_ungated("qp", "lab-open"),
    *_ungated("escape", "lab-open"),
    *_ungated("escape", "lab-aside"),
    *(_gated("qp", cell) for cell in CELLS[:2]),
    *(_gated("escape", cell) for cell in CELLS),
)
