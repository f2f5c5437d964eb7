"""The claims: the paper's, and stricter ones of the controllers here."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from deltaq_experiments.options import Options
from studies.claims import claim as q
from studies.claims.claim import Claim, JsonReport

LENGTH_S = 20.0
"""Of a run of tracking or collision: ten seeds of this tell more than one seed of twice as much [s]."""

BETWEEN_THE_FINGERS_M = (0.0, 0.0, 0.0)
"""A point that the gripper's own fingers hide, in the tool's frame [m]."""


def _within(angle_deg: float, distance_m: float) -> Callable[[JsonReport], bool]:
    return lambda r: r["angle_deg"]["max"] <= angle_deg and r["distance_m"]["max"] <= distance_m


def _reached_in(time_s: float) -> Callable[[JsonReport], bool]:
    return lambda r: (
        r["time_to_1_deg_s"] is not None
        and r["time_to_1_deg_s"] <= time_s
        and all(start["largest_rise_deg"] < 0.05 for start in r["starts"])
    )


def _plateaus(report: JsonReport) -> bool:
    *in_reach, out_of_reach = report["plateaus"]
    explained = out_of_reach["reached"] or out_of_reach["why_not"]
    return bool(explained) and all(p["reached"] and p["largest_angle_deg"] <= 1.0 for p in in_reach)


def _plateaus_and_view(report: JsonReport) -> bool:
    return _plateaus(report) and bool(report["angle_deg"]["max"] <= 1.0)


_APPROACH = (q.SLOWEST, q.RISE, q.SEEN)
_TRACKING = (q.ANGLE, q.ANGLE_RMS, q.DISTANCE, q.LEADER_MEAN, q.LEADER_PEAK, q.ROLL, q.SEEN)
_ZOOM = (
    q.IN_REACH,
    q.IN_REACH_ANGLE,
    q.ON_THE_WAY,
    q.OUT_OF_REACH,
    q.LEADER_MEAN,
    q.LEADER_PEAK,
    q.ROLL,
    q.SEEN,
)


def _tracking(claim: str, angle_deg: float, distance_m: float, picture: str = "", **options: Any) -> Claim:
    holds = _within(angle_deg, distance_m)
    return Claim("tracking", Options(duration_s=LENGTH_S, **options), claim, holds, _TRACKING, picture)


CLAIMS = (
    Claim(
        "approach",
        Options(controller="paper"),
        "Fig. 8: monotone; below 1° in 2 s",
        _reached_in(2.0),
        _APPROACH,
        "fig-8-paper",
    ),
    Claim(
        "approach",
        Options(controller="qp"),
        "monotone; below 1° in 1 s",
        _reached_in(1.0),
        _APPROACH,
        "fig-8-qp",
    ),
    _tracking("Fig. 9: ±1°, ±2 cm", 1.0, 0.021, controller="paper", leader_speed_m_s=0.15),
    _tracking("the same at 0.25 m/s", 1.0, 0.021, "fig-9-paper", controller="paper"),
    _tracking("the paper's future work (VII-B): 0.1°, 0.3 cm", 0.1, 0.003, controller="predictive"),
    _tracking("asked for 0.5 m/s: 0.1°, 0.3 cm", 0.1, 0.003, controller="predictive", leader_speed_m_s=0.5),
    Claim(
        "tracking",
        Options(controller="qp", duration_s=LENGTH_S),
        "0.1°, 0.3 cm, and both eyes see the point all the time",
        lambda r: _within(0.1, 0.003)(r) and bool(r["seen"]["by_all_eyes"] == 1.0),
        _TRACKING,
        "fig-9-qp",
    ),
    Claim(
        "tracking",
        Options(controller="clear-view", duration_s=LENGTH_S, aim_offset_m=BETWEEN_THE_FINGERS_M),
        "both eyes see the point between the fingers more than half of the time, within 0.3°",
        lambda r: bool(r["angle_deg"]["max"] <= 0.3 and r["seen"]["by_all_eyes"] > 0.5),
        _TRACKING,
        "clear-view",
    ),
    _tracking("asked for 0.5 m/s: 0.1°, 0.3 cm", 0.1, 0.003, controller="qp", leader_speed_m_s=0.5),
    _tracking("asked for 1 m/s: 0.2°, 1 cm", 0.2, 0.01, controller="qp", leader_speed_m_s=1.0),
    _tracking("and with 8 m/s²", 0.2, 0.01, controller="qp", leader_speed_m_s=1.0, stick_m_s2=8.0),
    Claim(
        "zoom",
        Options(controller="paper"),
        "Fig. 10: the distance is kept except where F_rep or a limit prevents it; the angle is unaffected",
        _plateaus,
        _ZOOM,
        "fig-10-paper",
    ),
    Claim(
        "zoom",
        Options(controller="predictive"),
        "with an extrapolated focus: within 1 cm and 1° at distances in reach",
        _plateaus,
        _ZOOM,
    ),
    Claim(
        "zoom",
        Options(controller="qp"),
        "within 1 cm at distances in reach, and reported if out of reach; within 1° also on the way",
        _plateaus_and_view,
        _ZOOM,
        "fig-10-qp",
    ),
)


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
