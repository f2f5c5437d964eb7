"""The paper's approach (VI-B, Fig. 8): three starts with a large error, and a leader at rest."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from pydantic import BaseModel

from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.figures import Curve, FigurePanel
from deltaq_experiments.live import run_live
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome, Report
from deltaq_experiments.scene import (
    VIEW_DISTANCE_M,
    aim_arguments,
    camera_controller,
    load,
    start_with_error,
)
from deltaq_experiments.seen import CameraRun, seen, summary
from deltaq_experiments.trace import time_to_stay_below
from deltaq_experiments.virtual import record
from deltaq_protocol.arrays import Array

DURATION_S = 5.0
START_ERRORS_DEG = (83.0, 134.0, 145.0)


class ApproachStart(BaseModel, frozen=True):
    """One start.

    Attributes:
        start_deg: view angle error at the start.
        time_to_1_deg_s: from when on it stayed below 1 degree, None if it did not.
        largest_rise_deg: largest rise of the error until then; 0 for a monotone approach.
        final_deg: error at the end.
        final_distance_m: error of the view distance at the end.
    """

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
    # all counts, from the start; the leader is at rest
    options = replace(options.lasting(DURATION_S), settle_s=0.0, leader_speed_m_s=0.0)
    scene = load(options)
    began_s = time.perf_counter()
    runs = [
        _run_from(options, scene, math.radians(error), options.seed + index)
        for index, error in enumerate(START_ERRORS_DEG)
    ]
    elapsed_s = time.perf_counter() - began_s
    starts = tuple(
        approach_of(run.recording.trace.time_s, run.angle_deg, run.distance_error_m) for run in runs
    )
    report = ApproachReport(**summary("approach", options, scene, elapsed_s, *runs), starts=starts)
    return ExperimentOutcome(report, _panels(runs))


def _run_from(options: Options, scene: Scene, error: float, seed: int) -> CameraRun:
    camera = camera_controller(scene, options.controller)
    start = start_with_error(scene, camera, error, seed)
    if options.live:
        starting = ["--start", *(f"{value:.9f}" for value in start)]
        recording = run_live(options, scene, [*starting, *aim_arguments(options)], leading=None)
    else:
        recording = record(options, camera, start={scene.robot_name: start})
    views, looks = recording.trace.views(camera, scene), seen(scene, recording.trace, scene.focus_at)
    return CameraRun(recording, views[:, 0], views[:, 1] - VIEW_DISTANCE_M, looks)


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


def _panels(runs: list[CameraRun]) -> tuple[FigurePanel, ...]:
    def lines(values: Callable[[CameraRun], Array]) -> tuple[Curve, ...]:
        return tuple(
            Curve(f"from {run.angle_deg[0]:.0f}°", run.recording.trace.time_s, values(run)) for run in runs
        )

    clock = runs[0].recording.trace.time_s
    desired = Curve("desired", clock, np.full_like(clock, VIEW_DISTANCE_M), "--")
    distances = lines(lambda run: run.distance_error_m + VIEW_DISTANCE_M)
    return (
        FigurePanel("View angle error", "deg", lines(lambda run: run.angle_deg), bound=1.0),
        FigurePanel("View distance", "m", (*distances, desired)),
    )
