"""The figures of the experiments' reports that claims are about."""

from __future__ import annotations

import math

from studies.claims.claim import JsonReport, Quantity


def _slowest_s(report: JsonReport) -> float:
    time_s = report["time_to_1_deg_s"]
    return math.inf if time_s is None else float(time_s)


def _greatest_rise(report: JsonReport) -> float:
    return max(float(start["largest_rise_deg"]) for start in report["starts"])


def _plateau_error(report: JsonReport) -> float:
    return max(float(plateau["error_m"]) for plateau in report["plateaus"][:-1])


def _plateau_angle(report: JsonReport) -> float:
    return max(float(plateau["largest_angle_deg"]) for plateau in report["plateaus"][:-1])


def _followers_held_share(report: JsonReport) -> float:
    counts: dict[str, int] = report["gate_by_robot"][report["robot"]]
    return float(counts["held"] + counts["refused"]) / max(sum(counts.values()), 1)


ANGLE = Quantity("angle", lambda r: float(r["angle_deg"]["max"]), "°")
ANGLE_RMS = Quantity("angle rms", lambda r: float(r["angle_deg"]["rms"]), "°")
DISTANCE = Quantity("distance", lambda r: float(r["distance_m"]["max"]), " cm", 100.0, 1)
SEEN = Quantity("seen", lambda r: float(r["seen"]["by_all_eyes"]), " %", 100.0, 0, least_is_worst=True)
ROLL = Quantity("roll", lambda r: float(r["roll_deg"]["max"]), "°", decimals=0)
CLEARANCE = Quantity(
    "clearance", lambda r: float(r["clearance_m"]["robots_min"]), " cm", 100.0, 1, least_is_worst=True
)
CONTACTS = Quantity("contacts", lambda r: float(r["contacts"]), "", decimals=0)
BELOW_1_DEG = Quantity(
    "below 1°", lambda r: float(r["angle_below_1_deg_share"]), " % of cycles", 100.0, 0, least_is_worst=True
)
LEADER_MEAN = Quantity(
    "leader's mean", lambda r: float(r["leader_reached_m_s"]["mean"]), " m/s", least_is_worst=True
)
LEADER_PEAK = Quantity("peak", lambda r: float(r["leader_reached_m_s"]["peak"]), " m/s", least_is_worst=True)
PRESSURE = Quantity(
    "attacker free", lambda r: float(r["attack_pressure"]), " %", 100.0, 0, least_is_worst=True
)
HELD = Quantity("follower held", _followers_held_share, " %", 100.0, 0)
SLOWEST = Quantity("slowest start", _slowest_s, " s")
RISE = Quantity("rise on the way", _greatest_rise, "°")
IN_REACH = Quantity("distances in reach", _plateau_error, " cm", 100.0, 1)
IN_REACH_ANGLE = Quantity("angle there", _plateau_angle, "°")
OUT_OF_REACH = Quantity("2.6 m", lambda r: float(r["plateaus"][-1]["error_m"]), " cm", 100.0, 0)
ON_THE_WAY = Quantity("angle on the way", lambda r: float(r["angle_deg"]["max"]), "°", decimals=1)
