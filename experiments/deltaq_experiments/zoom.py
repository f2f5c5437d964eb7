"""The paper's zooming (VI-D, Fig. 10): the operator changes the view distance while the camera tracks."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from deltaq_controllers.camera.controllers import FocusController
from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.figures import Curve, FigurePanel, Marks, distance_panel
from deltaq_experiments.live import run_live
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome, Report
from deltaq_experiments.scene import VIEW_DISTANCE_M, aim_arguments, camera_controller, load
from deltaq_experiments.seen import CameraRun, seen, summary
from deltaq_experiments.tracking import scripted_leader
from deltaq_experiments.virtual import RunRecord, record
from deltaq_protocol.arrays import Array

DURATION_S = 40.0
DISTANCES_M = (VIEW_DISTANCE_M, 1.0, 1.5, 0.8, 2.6)
"""Distances that the operator requests in turn; the last one is farther than the arm reaches back."""

REACHED_M = 0.01
"""Error of a plateau that counts as reached."""


class Plateau(BaseModel, frozen=True):
    """One desired distance.

    Attributes:
        from_s: when it was asked for.
        desired_m: the distance.
        error_m: root mean square error over the last third of its time.
        largest_error_m: largest error of that time.
        largest_angle_deg: largest view angle error of that time.
        reached: whether `error_m` is within a centimetre.
        why_not: the obstacle; None if it was reached.
    """

    from_s: float
    desired_m: float
    error_m: float
    largest_error_m: float
    largest_angle_deg: float
    reached: bool
    why_not: str | None


class ZoomReport(Report):
    """The common figures, and each desired distance by itself."""

    plateaus: tuple[Plateau, ...]


@dataclass(frozen=True)
class Views:
    """The camera's views over time, (k,) each."""

    angle_deg: Array
    distance_m: Array
    desired_m: Array
    near_limit: NDArray[np.bool_]
    evading: NDArray[np.bool_]


def run(options: Options) -> ExperimentOutcome:
    """Run the experiment in virtual time, or live over real processes.

    Raises:
        DeltaqError: if the cell has no such robots.
    """
    options = options.lasting(DURATION_S)
    scene = load(options)
    hold_s = options.length_s / len(DISTANCES_M)
    camera = camera_controller(scene, options.controller)
    began_s = time.perf_counter()
    recording = _recorded(options, scene, camera, hold_s)
    elapsed_s = time.perf_counter() - began_s
    views = _views(scene, recording, camera, hold_s)
    clock = recording.trace.time_s
    looks = seen(scene, recording.trace, scene.focus_at)
    run = CameraRun(recording, views.angle_deg, views.distance_m - views.desired_m, looks)
    report = ZoomReport(
        **summary("zoom", options, scene, elapsed_s, run),
        plateaus=tuple(
            plateau(views, clock, index * hold_s, (index + 1) * hold_s) for index in range(len(DISTANCES_M))
        ),
    )
    return ExperimentOutcome(report, _panels(clock, views, looks.hidden()))


def _recorded(options: Options, scene: Scene, camera: FocusController, hold_s: float) -> RunRecord:
    if options.live:
        distances = [f"{distance:g}" for distance in DISTANCES_M]
        zooming = ["--hold-s", f"{hold_s}", "--distances-m", *distances]
        return run_live(options, scene, [*zooming, *aim_arguments(options)])

    def turn_the_dial(time_s: float) -> None:
        camera.desired_distance_m = desired_at(time_s, hold_s)

    return record(options, camera, scripted_leader(options, scene), before_cycle=turn_the_dial)


def desired_at(time_s: float, hold_s: float) -> float:
    """The distance that the operator asks for [m]."""
    return DISTANCES_M[min(int(time_s / hold_s), len(DISTANCES_M) - 1)]


def plateau(views: Views, clock: Array, from_s: float, to_s: float) -> Plateau:
    """Judge one desired distance by the last third of its time."""
    end = (clock >= to_s - (to_s - from_s) / 3.0) & (clock < to_s)
    error = (views.distance_m - views.desired_m)[end]
    rms = float(np.sqrt(np.mean(error**2)))
    reached, on_average = rms <= REACHED_M, abs(float(np.mean(error))) <= REACHED_M
    return Plateau(
        from_s=from_s,
        desired_m=float(views.desired_m[end][-1]),
        error_m=rms,
        largest_error_m=float(np.abs(error).max()),
        largest_angle_deg=float(views.angle_deg[end].max()),
        reached=reached,
        why_not=None if reached else _why(views.near_limit[end], views.evading[end], on_average),
    )


def _why(near_limit: NDArray[np.bool_], evading: NDArray[np.bool_], on_average: bool) -> str:
    if on_average:
        return "reached on average only: the leader moves on meanwhile"
    causes = {
        "a joint is near its limit": float(near_limit.mean()),
        "something is in the way": float(evading.mean()),
    }
    found = [cause for cause, share in causes.items() if share > 0.5]
    return " and ".join(found) if found else "the arm reaches no farther, or the camera is still on its way"


def _views(scene: Scene, recording: RunRecord, camera: FocusController, hold_s: float) -> Views:
    trace = recording.trace
    views = trace.views(camera, scene)
    return Views(
        views[:, 0],
        views[:, 1],
        np.array([desired_at(time_s, hold_s) for time_s in trace.time_s]),
        trace.near_limit(scene.robot),
        trace.clearances(camera, scene) < camera.evades_below_m,
    )


def _panels(clock: Array, views: Views, hidden: Marks) -> tuple[FigurePanel, ...]:
    marks = (
        Marks("joint near its limit", clock, views.near_limit),
        Marks("F_rep acts", clock, views.evading),
    )
    return (
        FigurePanel(
            "View angle error", "deg", (Curve("", clock, views.angle_deg),), (*marks, hidden), bound=1.0
        ),
        distance_panel(clock, views.distance_m, views.desired_m, marks),
    )
