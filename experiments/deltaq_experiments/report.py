"""What an experiment reports: the public JSON of `deltaq experiment`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from deltaq_experiments.figures import FigurePanel
from deltaq_protocol.arrays import Array
from deltaq_testing.oracle import GateCounts, LimitCounts


class Figures(BaseModel, frozen=True):
    """Root mean square and largest value after the settling time, and the last value."""

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


class LeastClearance(BaseModel, frozen=True):
    """Least distance of bodies, measured by the independent checker on every recorded configuration."""

    min: float
    """Between the robots, and between robots and structure."""
    pair: tuple[str, str]
    robots_min: float
    """Between the robots."""
    self_min: float
    """Between two bodies of one robot."""

    @classmethod
    def of(cls, runs: Sequence[LeastClearance]) -> LeastClearance:
        """The least of some runs."""
        nearest = min(runs, key=lambda run: run.min)
        robots_min, self_min = min(run.robots_min for run in runs), min(run.self_min for run in runs)
        return cls(min=nearest.min, pair=nearest.pair, robots_min=robots_min, self_min=self_min)


class ReachedSpeed(BaseModel, frozen=True):
    """Speed that the leader's tool reached after the settling time [m/s]."""

    mean: float
    """Length of its path over the time."""
    peak: float
    """The largest over any 60 ms."""


class SeenShares(BaseModel, frozen=True):
    """Shares of the time in which the camera saw its target, after the settling time."""

    by_all_eyes: float
    """Within the picture of every eye, and nothing on any line of sight."""
    by_one_eye: float
    """Seen by one eye at least."""
    in_picture: float
    """Within the picture of every eye, hidden or not."""
    blocked_by: dict[str, float]
    """Something of this robot, or of the structure, on a line of sight."""
    bodies: dict[str, float]
    """The same by body, the most frequent first."""


class Report(BaseModel, frozen=True):
    """One run of an experiment."""

    experiment: str
    controller: str
    robot: str
    """The one with the camera."""
    leader: str
    """The one that is watched."""
    seed: int
    live: bool
    cycles: int
    cycle_s: float
    latency_s: float
    """By which a link delayed the leader's states on their way to the camera's controller."""
    loop_latency_s: float
    """From the leader's motion to the camera's without that: the drives' lag, and three cycles."""
    leader_speed_m_s: float
    """That its tool was asked for."""
    stick_m_s2: float
    """Largest acceleration that it was asked for."""
    leader_reached_m_s: ReachedSpeed
    angle_deg: Figures
    distance_m: Figures
    roll_deg: Figures
    """Of the picture, about the view axis."""
    seen: SeenShares
    time_to_1_deg_s: float | None
    """From when on the view angle error stays below 1 degree; None if it does not."""
    clearance_m: LeastClearance
    limits: LimitCounts
    gate: GateCounts
    reasons: dict[str, int]
    real_time_factor: float


@dataclass(frozen=True)
class ExperimentOutcome:
    """Result of an experiment.

    Attributes:
        report: its figures.
        panels: its picture, laid out as in the paper.
    """

    report: Report
    panels: tuple[FigurePanel, ...]
