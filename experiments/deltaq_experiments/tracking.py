"""The paper's camera tracking (VI-C, Fig. 9): the leader moves about, the camera keeps it in view."""

from __future__ import annotations

import time

import numpy as np

from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.figures import Curve, FigurePanel, Marks
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome, Report
from deltaq_experiments.scene import VIEW_DISTANCE_M, aim_arguments, camera_controller, load
from deltaq_experiments.seen import seen, summary
from deltaq_experiments.trace import Trace
from deltaq_experiments.virtual import RunRecord, record

DURATION_S = 40.0


def run(options: Options) -> ExperimentOutcome:
    """Run the experiment in virtual time, or live over real processes.

    Raises:
        DeltaqError: if the cell has no such robots.
    """
    options = options.lasting(DURATION_S)
    scene = load(options)
    began_s = time.perf_counter()
    recording = _run_live(options, scene) if options.live else _run_virtual(options, scene)
    elapsed_s = time.perf_counter() - began_s
    trace = recording.trace
    views = trace.views(camera_controller(scene, options.controller), scene)
    looks = seen(scene, trace, scene.focus_at)
    angle, error = views[:, 0], views[:, 1] - VIEW_DISTANCE_M
    report = Report(**summary("tracking", options, scene, recording, angle, error, looks, elapsed_s))
    return ExperimentOutcome(report, panels(scene, trace, angle, views[:, 1], (looks.hidden(),)))


def _run_virtual(options: Options, scene: Scene) -> RunRecord:
    return record(options, camera_controller(scene, options.controller), scripted_leader(options, scene))


def scripted_leader(options: Options, scene: Scene) -> ScriptedLeader:
    """The leader that moves its tool about, as the options ask."""
    speed, seed, stick = options.leader_speed_m_s, options.seed, options.stick_m_s2
    return ScriptedLeader(scene.leader, scene.cycle_s, speed, seed, stick_m_s2=stick)


def _run_live(options: Options, scene: Scene) -> RunRecord:
    from deltaq_experiments.live import run_live

    return run_live(options, scene, aim_arguments(options))


def panels(
    scene: Scene, trace: Trace, angle: np.ndarray, distance: np.ndarray, marks: tuple[Marks, ...] = ()
) -> tuple[FigurePanel, ...]:
    """The layout of Fig. 9.

    Args:
        scene: the roles of the recorded robots.
        trace: of both robots.
        angle: (k,) view angle error [deg].
        distance: (k,) view distance [m].
        marks: marked times beside the angle.
    """
    clock, p = trace.time_s, trace.points(scene.leader)
    moved = p - p[0]
    size = np.linalg.norm(moved, axis=1)
    scaled = size * (float(angle.max()) / max(float(size.max()), 1e-9))
    return (
        FigurePanel(
            "View angle error; dotted: |p|, scaled",
            "deg",
            (Curve("angle error", clock, angle), Curve("|p|", clock, scaled, ":")),
            marks,
            bound=1.0,
        ),
        FigurePanel(
            "View distance",
            "m",
            (
                Curve("distance", clock, distance),
                Curve("desired", clock, np.full_like(clock, VIEW_DISTANCE_M), "--"),
            ),
        ),
        FigurePanel(
            "Leader's tool, from where it began",
            "m",
            tuple(Curve(axis, clock, moved[:, k]) for k, axis in enumerate("xyz")),
        ),
    )
