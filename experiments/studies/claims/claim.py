"""A claim about an experiment, and what came of it over some seeds."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltaq_experiments.options import Options

JsonReport = dict[str, Any]
"""A report of an experiment as its public JSON."""


@dataclass(frozen=True)
class Quantity:
    """One figure of a run.

    Attributes:
        name: what it is.
        of: takes it from a report; infinite for what never came about.
        unit: that people read.
        scale: from the report's unit to that one.
        decimals: that are shown.
        least_is_worst: as of a clearance; of an error it is the greatest.
    """

    name: str
    of: Callable[[JsonReport], float]
    unit: str
    scale: float = 1.0
    decimals: int = 2
    least_is_worst: bool = False

    def text(self, value: float) -> str:
        """A value with its unit."""
        number = f"{self.scale * value:.{self.decimals}f}" if math.isfinite(value) else "never"
        return f"{self.name} {number}{self.unit if math.isfinite(value) else ''}"


@dataclass(frozen=True)
class Claim:
    """One row of the table.

    Attributes:
        experiment: module of `deltaq_experiments`.
        options: of the runs; its seed is the first one.
        claim: the paper's claim, or a stricter one.
        holds: whether a report confirms it.
        quantities: the relevant figures of a report.
        picture: name of the picture of the first run that is kept; empty for none.
    """

    experiment: str
    options: Options
    claim: str
    holds: Callable[[JsonReport], bool]
    quantities: tuple[Quantity, ...]
    picture: str = ""

    @property
    def command(self) -> str:
        """How to run it by hand, but for the seed."""
        options = self.options
        words = ["deltaq experiment", self.experiment]
        if options.cell != Options.cell:
            words += ["--cell", f"{options.cell}"]
        words += ["--controller", options.controller]
        if options.leader_speed_m_s != Options.leader_speed_m_s:
            words += ["--leader-speed-m-s", f"{options.leader_speed_m_s:g}"]
        if options.stick_m_s2 != Options.stick_m_s2:
            words += ["--stick-m-s2", f"{options.stick_m_s2:g}"]
        if options.target != Options.target:
            words += ["--target", options.target]
        if options.aim_offset_m != Options.aim_offset_m:
            words += ["--aim-offset-m", *(f"{part:g}" for part in options.aim_offset_m)]
        if not options.gated:
            words.append("--no-gate")
        if options.settle_s != Options.settle_s:
            words += ["--settle-s", f"{options.settle_s:g}"]
        if options.duration_s is not None:
            words += ["--duration-s", f"{options.duration_s:g}"]
        return " ".join(words)


@dataclass(frozen=True)
class ClaimOutcome:
    """What came of a claim.

    Attributes:
        claim: the claim.
        reports: of its runs, in the order of their seeds; at least one.
    """

    claim: Claim
    reports: list[JsonReport]

    def medians(self) -> str:
        """The median of each quantity."""
        claim = self.claim
        return ", ".join(q.text(float(np.median(self._values(q)))) for q in claim.quantities)

    def worst(self) -> str:
        """The worst value of each quantity, and the seed that it came with."""
        told = []
        for quantity in self.claim.quantities:
            values = self._values(quantity)
            index = int(np.argmin(values) if quantity.least_is_worst else np.argmax(values))
            told.append(f"{quantity.text(values[index])} ({self.reports[index]['seed']})")
        return ", ".join(told)

    def share(self) -> str:
        """In how many of the runs the claim holds, and the seeds of those in which it does not."""
        missed = [str(report["seed"]) for report in self.reports if not self.claim.holds(report)]
        runs = len(self.reports)
        if not missed:
            return f"{runs} of {runs}"
        return f"**{runs - len(missed)} of {runs}**, not {', '.join(missed)}"

    def _values(self, quantity: Quantity) -> list[float]:
        return [quantity.of(report) for report in self.reports]


class KeptReports:
    """A report for each run, in a file whose name says which.

    Args:
        folder: where they are kept; None: nowhere.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def get(self, claim: Claim, seed: int) -> JsonReport | None:
        """The report of a run, if it was kept."""
        file = self._file(claim, seed)
        if file is None or not file.exists():
            return None
        report: JsonReport = json.loads(file.read_text(encoding="utf-8"))
        return report

    def put(self, claim: Claim, seed: int, report: JsonReport) -> JsonReport:
        """Keep the report of a run; returns it."""
        file = self._file(claim, seed)
        if file is not None:
            file.write_text(json.dumps(report), encoding="utf-8")
        return report

    def _file(self, claim: Claim, seed: int) -> Path | None:
        words = claim.command.removeprefix("deltaq experiment ").replace("--", "").split()
        return None if self._folder is None else self._folder / f"{'-'.join(words)}-seed-{seed}.json"


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
