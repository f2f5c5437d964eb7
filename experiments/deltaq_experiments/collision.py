"""The paper's collision avoidance (VI-E, Fig. 11): the leader tries to hit the follower; the focus is fixed."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.camera.controllers import FocusController
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.leader.attacking import TARGETS, AttackingLeader
from deltaq_experiments.attack_starts import attack_start
from deltaq_experiments.options import Options
from deltaq_experiments.panels import Curve, FigurePanel, Marks
from deltaq_experiments.pressure import Pressing
from deltaq_experiments.report import ExperimentOutcome, Report
from deltaq_experiments.scene import VIEW_DISTANCE_M, camera_controller, load
from deltaq_experiments.seen import seen
from deltaq_experiments.summary import summary
from deltaq_experiments.ungated import record_ungated
from deltaq_experiments.virtual import RunRecord, record
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_verification.counts import GateCounts

DURATION_S = 40.0


class CollisionReport(Report):
    """The common figures, and the outcome of the attacks.

    Attributes:
        target: the part that they homed in on.
        contacts: cycles in which bodies of the two robots touched.
        evading_share: fraction of the cycles in which the follower got out of the way.
        angle_below_1_deg_share: fraction of the cycles, after the settling time, in which the focus was kept within a
            degree.
        gated: whether a gate stopped the robots.
        gate_by_robot: verdicts of each robot by outcome; empty over real processes, and without a gate.
        attack_pressure: fraction of the attacking cycles in which the attacker's tool moved as requested, and was not
            held by the gate or by its own limits; None over real processes.
    """

    target: str
    contacts: int
    evading_share: float
    angle_below_1_deg_share: float
    gated: bool
    gate_by_robot: dict[str, GateCounts]
    attack_pressure: float | None


def run(options: Options) -> ExperimentOutcome:
    """Run the experiment in virtual time, or live over real processes.

    Raises:
        DeltaqError: if the loop alone is slower than the latency asked for, the cell has no such robots, or there
            is no such target.
    """
    options = options.lasting(DURATION_S)
    scene = load(options)
    if options.target not in TARGETS:
        raise DeltaqError(f"--target {options.target}: there are {', '.join(TARGETS)}")
    focus = scene.leader.forward(scene.leader.home)[:3, 3]
    camera = camera_controller(scene, options.controller, focus=focus)
    _refuse_without_a_gate(options)
    began_s = time.perf_counter()
    attacker = _attacker(options, scene)
    run_live, run_virtual = partial(_run_live, options, scene, focus), partial(_run_virtual, options, scene)
    recording = run_live() if options.live else run_virtual(camera, attacker)
    elapsed_s = time.perf_counter() - began_s
    trace = recording.trace
    views = trace.views(camera, scene)
    between = trace.robot_clearances(scene.cell)
    evading = trace.clearances(camera, scene) < camera.evades_below_m
    error = views[:, 1] - VIEW_DISTANCE_M
    looks = seen(scene, trace, lambda _q_leader: focus)
    report = CollisionReport(
        **summary("collision", options, scene, recording, views[:, 0], error, looks, elapsed_s),
        target=options.target,
        contacts=int((between <= 0.0).sum()),
        evading_share=float(evading.mean()),
        angle_below_1_deg_share=_share_below_1_deg(options, trace.time_s, views[:, 0]),
        gated=options.gated,
        gate_by_robot=recording.gate_by_robot,
        attack_pressure=attacker.share,
    )
    return ExperimentOutcome(report, _panels(recording, views, between, evading, looks.hidden()))


def _share_below_1_deg(options: Options, time_s: Array, angle_deg: Array) -> float:
    settled = angle_deg[time_s >= options.settle_s]
    return float(((settled if settled.size else angle_deg) < 1.0).mean())


def _refuse_without_a_gate(options: Options) -> None:
    if not options.gated and (options.live or options.record is not None):
        raise DeltaqError("--no-gate runs without services: neither --live nor --record goes with it")


def _attacker(options: Options, scene: Scene) -> Pressing:
    leader = AttackingLeader(
        scene.leader,
        scene.robot,
        scene.cycle_s,
        options.leader_speed_m_s,
        options.seed,
        options.target,
        options.stick_m_s2,
    )
    return Pressing(leader, scene.leader, scene.cycle_s)


def _run_virtual(options: Options, scene: Scene, camera: FocusController, attacker: Pressing) -> RunRecord:
    start = attack_start(scene, camera, options.seed)
    if options.gated:
        return record(options, camera, attacker, start)
    return record_ungated(options, scene, camera, attacker, start)


def _run_live(options: Options, scene: Scene, focus: Array) -> RunRecord:
    from deltaq_experiments.live import run_live

    following = ["--focus-m", *(f"{value:.9f}" for value in focus)]
    return run_live(options, scene, following, ["--attack", scene.robot_name, "--target", options.target])


def _panels(
    recording: RunRecord, views: Array, between: Array, evading: NDArray[np.bool_], hidden: Marks
) -> tuple[FigurePanel, ...]:
    clock = recording.trace.time_s
    marks = (Marks("F_rep acts", clock, evading),)
    return (
        FigurePanel("View angle error", "deg", (Curve("", clock, views[:, 0]),), (*marks, hidden), bound=1.0),
        FigurePanel(
            "View distance",
            "m",
            (
                Curve("distance", clock, views[:, 1]),
                Curve("desired", clock, np.full_like(clock, VIEW_DISTANCE_M), "--"),
            ),
            marks,
        ),
        FigurePanel("Clearance between the robots", "m", (Curve("", clock, between),)),
    )
