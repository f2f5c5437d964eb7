"""A claim about an experiment, and what came of it over some seeds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
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
