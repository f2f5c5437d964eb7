"""The paper's approach (VI-B, Fig. 8): three starts with a large error, and a leader at rest."""

import math
import time

import numpy as np
from pydantic import BaseModel, ConfigDict

from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.figures import Curve, FigurePanel
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome, Figures, LeastClearance, ReachedSpeed, Report
from deltaq_experiments.scene import (
    VIEW_DISTANCE_M,
    aim_arguments,
    camera_controller,
    load,
    loop_latency_s,
    start_with_error,
)
from deltaq_experiments.seen import SeenRun, seen, shares_of
from deltaq_experiments.trace import time_to_stay_below
from deltaq_experiments.virtual import RunRecord, record
from deltaq_protocol.arrays import Array
from deltaq_testing.oracle import GateCounts, LimitCounts

DURATION_S = 5.0
START_ERRORS_DEG = (83.0, 134.0, 145.0)


class ApproachStart(BaseModel):
    """One start.

    Attributes:
        start_deg: view angle error at the start.
        time_to_1_deg_s: from when on it stayed below 1 degree, None if it did not.
        largest_rise_deg: largest rise of the error until then; 0 for a monotone approach.
        final_deg: error at the end.
        final_distance_m: error of the view distance at the end.
    """

    model_config = ConfigDict(frozen=True)

    start_deg: float
    time_to_1_deg_s: float | None
    largest_rise_deg: float
    final_deg: float
    final_distance_m: float


class ApproachReport(Report):
    """The common figures over all starts together, from the start, and each start by itself."""

    starts: tuple[ApproachStart, ...]


def run(options: Options) -> ExperimentOutcome:
    """Run the experiment in virtual time, or live over real processes, where the robot goes to each start first.

    Raises:
        DeltaqError: if the cell has no such robots, or no start was found.
    """
    options = options.lasting(DURATION_S)
    scene = load(options)
    began_s = time.perf_counter()
    runs = [
        _run_from(options, scene, math.radians(error), options.seed + index)
        for index, error in enumerate(START_ERRORS_DEG)
    ]
    elapsed_s = time.perf_counter() - began_s
    return ExperimentOutcome(_report(options, scene, runs, elapsed_s), _panels(runs))


RunViews = tuple[RunRecord, Array, SeenRun]
"""A recording, (k, 2) view angle error [deg] and view distance [m], and the target's visibility."""


def _run_from(options: Options, scene: Scene, error: float, seed: int) -> RunViews:
    camera = camera_controller(scene, options.controller)
    start = start_with_error(scene, camera, error, seed)
    recording = (
        _run_live(options, scene, start)
        if options.live
        else record(options, camera, start={scene.robot_name: start})
    )
    looks = seen(scene, recording.trace, scene.focus_at)
    return recording, recording.trace.views(camera, scene), looks


def _run_live(options: Options, scene: Scene, start: Array) -> RunRecord:
    from deltaq_experiments.live import run_live

    starting = ["--start", *(f"{value:.9f}" for value in start)]
    return run_live(options, scene, [*starting, *aim_arguments(options)], leading=None)


def approach_of(time_s: Array, angle_deg: Array, distance_error_m: Array) -> ApproachStart:
    """Figures of one start from its (k,) times, errors of angle and errors of distance."""
    reached = time_to_stay_below(time_s, angle_deg, 1.0)
    way = angle_deg if reached is None else angle_deg[time_s <= reached]
    rise = float(np.max(way - np.minimum.accumulate(way)))
    return ApproachStart(
        start_deg=float(angle_deg[0]),
        time_to_1_deg_s=reached,
        largest_rise_deg=rise,
        final_deg=float(angle_deg[-1]),
        final_distance_m=float(abs(distance_error_m[-1])),
    )


def _report(options: Options, scene: Scene, runs: list[RunViews], elapsed_s: float) -> ApproachReport:
    starts = [
        approach_of(recording.trace.time_s, views[:, 0], views[:, 1] - VIEW_DISTANCE_M)
        for recording, views, _ in runs
    ]
    together = np.concatenate([views for _, views, _ in runs])
    rolls = np.concatenate([np.abs(recording.trace.rolls(scene.robot)) for recording, _, _ in runs])
    everything = np.ones(len(together), dtype=np.bool_)
    times = [start.time_to_1_deg_s for start in starts]
    clearances = [recording.trace.least_clearance(scene.cell) for recording, _, _ in runs]
    speeds = [recording.trace.reached_speed(scene.leader) for recording, _, _ in runs]
    nearest = min(clearances, key=lambda clearance: clearance.min)
    return ApproachReport(
        experiment="approach",
        controller=options.controller,
        robot=scene.robot_name,
        leader=scene.leader_name,
        seed=options.seed,
        live=options.live,
        cycles=len(together),
        cycle_s=scene.cycle_s,
        latency_s=options.latency_s,
        loop_latency_s=loop_latency_s(scene),
        leader_speed_m_s=0.0,
        stick_m_s2=options.stick_m_s2,
        leader_reached_m_s=ReachedSpeed(
            mean=float(np.mean([speed.mean for speed in speeds])), peak=max(speed.peak for speed in speeds)
        ),
        angle_deg=Figures.of(together[:, 0], everything),
        distance_m=Figures.of(np.abs(together[:, 1] - VIEW_DISTANCE_M), everything),
        roll_deg=Figures.of(rolls, everything),
        seen=shares_of([look for _, _, looks in runs for look in looks.looks]),
        time_to_1_deg_s=None if None in times else max(t for t in times if t is not None),
        clearance_m=LeastClearance(
            min=nearest.min,
            pair=nearest.pair,
            robots_min=min(clearance.robots_min for clearance in clearances),
            self_min=min(clearance.self_min for clearance in clearances),
        ),
        limits=LimitCounts.sum(recording.trace.limit_counts(scene.cell) for recording, _, _ in runs),
        gate=GateCounts.sum(recording.gate for recording, _, _ in runs),
        reasons={
            code: sum(recording.reasons.get(code, 0) for recording, _, _ in runs)
            for code in sorted({code for recording, _, _ in runs for code in recording.reasons})
        },
        real_time_factor=sum(float(recording.trace.time_s[-1]) for recording, _, _ in runs) / elapsed_s,
        starts=tuple(starts),
    )


def _panels(runs: list[RunViews]) -> tuple[FigurePanel, ...]:
    def lines(column: int) -> tuple[Curve, ...]:
        return tuple(
            Curve(f"from {views[0, 0]:.0f}°", recording.trace.time_s, views[:, column])
            for recording, views, _ in runs
        )

    clock = runs[0][0].trace.time_s
    desired = Curve("desired", clock, np.full_like(clock, VIEW_DISTANCE_M), "--")
    return (
        FigurePanel("View angle error", "deg", lines(0), bound=1.0),
        FigurePanel("View distance", "m", (*lines(1), desired)),
    )
