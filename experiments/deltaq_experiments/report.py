"""What an experiment reports: the public JSON of `deltaq experiment`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from deltaq_experiments.panels import Panel

Array = NDArray[np.float64]


class Figures(BaseModel):
    """Root mean square and largest value after the settling time, and the last value."""

    model_config = ConfigDict(frozen=True)

    rms: float
    max: float
    final: float

    @classmethod
    def of(cls, values: Array, settled: NDArray[np.bool_]) -> Figures:
        """Figures of absolute errors (cycles,), of which `settled` count for rms and max."""
        counted = values[settled] if settled.any() else values
        return cls(
            rms=float(np.sqrt(np.mean(counted**2))), max=float(np.max(counted)), final=float(values[-1])
        )


class LimitCounts(BaseModel):
    """Joints and cycles beyond a limit, from the emulated controllers' records."""

    model_config = ConfigDict(frozen=True)

    position_violations: int
    velocity_violations: int
    acceleration_violations: int

    @classmethod
    def sum(cls, counts: Iterable[LimitCounts]) -> LimitCounts:
        """All together."""
        return cls(**_added(counts))


class LeastClearance(BaseModel):
    """Least distance of bodies that an oracle measured on every recorded configuration."""

    model_config = ConfigDict(frozen=True)

    min: float
    """Between the robots, and between robots and structure."""
    pair: tuple[str, str]
    robots_min: float
    """Between the robots."""
    self_min: float
    """Between two bodies of one robot."""


class GateCounts(BaseModel):
    """Verdicts by outcome."""

    model_config = ConfigDict(frozen=True)

    admitted: int = 0
    scaled: int = 0
    held: int = 0
    refused: int = 0

    @classmethod
    def sum(cls, counts: Iterable[GateCounts]) -> GateCounts:
        """All together."""
        return cls(**_added(counts))

    @classmethod
    def of(cls, counts: dict[str, int]) -> GateCounts:
        """From a counter that may hold other counts as well."""
        return cls(**{name: counts.get(name, 0) for name in cls.model_fields})


class Report(BaseModel):
    """One run of an experiment."""

    model_config = ConfigDict(frozen=True)

    experiment: str
    controller: str
    seed: int
    live: bool
    cycles: int
    cycle_s: float
    latency_s: float
    leader_speed_m_s: float
    angle_deg: Figures
    distance_m: Figures
    time_to_1_deg_s: float | None
    clearance_m: LeastClearance
    limits: LimitCounts
    gate: GateCounts
    reasons: dict[str, int]
    real_time_factor: float


@dataclass(frozen=True)
class Outcome:
    """Result of an experiment.

    Attributes:
        report: its figures.
        panels: its picture, laid out as in the paper.
    """

    report: Report
    panels: tuple[Panel, ...]


def _added(counts: Iterable[BaseModel]) -> dict[str, int]:
    together: Counter[str] = Counter()
    for count in counts:
        together.update(count.model_dump())
    return dict(together)
