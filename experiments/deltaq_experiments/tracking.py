"""The paper's camera tracking (VI-C, Fig. 9): the leader moves about, the camera keeps it in view."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.roles import RoleError
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.figures import Curve, FigurePanel, Marks, distance_panel, draw
from deltaq_experiments.live import run_live, trace_of
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome, Report
from deltaq_experiments.scene import VIEW_DISTANCE_M, aim_arguments, camera_controller, load, scene_of
from deltaq_experiments.seen import CameraRun, seen, summary
from deltaq_experiments.trace import Trace
from deltaq_experiments.virtual import record
from deltaq_protocol import topics
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Outcome, RobotState, Verdict
from deltaq_services.recorder.reader import Recording

DURATION_S = 40.0


def run(options: Options) -> ExperimentOutcome:
    """Run the experiment in virtual time, or live over real processes.

    Raises:
        DeltaqError: if the cell has no such robots.
    """
    options = options.lasting(DURATION_S)
    scene = load(options)
    began_s = time.perf_counter()
    if options.live:
        recording = run_live(options, scene, aim_arguments(options))
    else:
        recording = record(
            options, camera_controller(scene, options.controller), scripted_leader(options, scene)
        )
    elapsed_s = time.perf_counter() - began_s
    views = recording.trace.views(camera_controller(scene, options.controller), scene)
    looks = seen(scene, recording.trace, scene.focus_at)
    run = CameraRun(recording, views[:, 0], views[:, 1] - VIEW_DISTANCE_M, looks)
    report = Report(**summary("tracking", options, scene, elapsed_s, run))
    return ExperimentOutcome(
        report, panels(scene, recording.trace, views[:, 0], views[:, 1], (looks.hidden(),))
    )


def scripted_leader(options: Options, scene: Scene) -> ScriptedLeader:
    """The leader that moves its tool about, as the options ask."""
    speed, seed, stick = options.leader_speed_m_s, options.seed, options.stick_m_s2
    return ScriptedLeader(scene.leader, scene.cycle_s, speed, seed, stick_m_s2=stick)


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
        distance_panel(clock, distance, VIEW_DISTANCE_M),
        FigurePanel(
            "Leader's tool, from where it began",
            "m",
            tuple(Curve(axis, clock, moved[:, k]) for k, axis in enumerate("xyz")),
        ),
    )


# A picture of a recording: of a robot with a camera how well it kept the leader in view, of others where tools went.


def plot(path: Path, picture: Path) -> list[str]:
    """Draw the picture of a recording.

    Returns:
        The parts of the recording that could not be read.

    Raises:
        DeltaqError: it is no recording of deltaq, or the picture cannot be written.
    """
    recording = Recording.open(path)
    draw(
        panels_of(recording),
        f"{path.name}, cell {recording.about['cell']}, {recording.about.get('source', '')}",
        picture,
    )
    return recording.notices


def panels_of(recording: Recording) -> tuple[FigurePanel, ...]:
    """View angle error with the gate's interventions, view distance, and the leader's path; or the tools' paths.

    Raises:
        DeltaqError: the recording has no states.
    """
    states: list[RobotState] = []
    times: list[float] = []
    begin_ns: int | None = None
    bound: dict[str, list[float]] = {}
    for item in recording.messages((topics.STATE, topics.GATE_VERDICT)):
        begin_ns = item.time_ns if begin_ns is None else begin_ns
        if isinstance(item.message, RobotState):
            states.append(item.message)
            times.append((item.time_ns - begin_ns) / 1e9)
        elif isinstance(item.message, Verdict) and item.message.outcome is not Outcome.ADMITTED:
            bound.setdefault(item.message.robot, []).append((item.time_ns - begin_ns) / 1e9)
    if not states:
        raise DeltaqError(f"{recording.path} has no states of any robot: there is nothing to draw")
    marks = {
        name: Marks(f"gate bound {name}", np.array(at), np.ones(len(at), dtype=bool))
        for name, at in bound.items()
    }
    cell = recording.cell()
    scene = _scene(cell)
    both = () if scene is None else (scene.robot_name, scene.leader_name)
    if scene is None or not set(both) <= {state.robot for state in states}:
        return tuple(_tool_path(name, states, times, marks) for name in cell.robots)
    trace = trace_of(states, both, {})
    views = trace.views(camera_controller(scene), scene)
    first, *others = panels(scene, trace, views[:, 0], views[:, 1])
    return (replace(first, marks=tuple(marks[name] for name in both if name in marks)), *others)


def _scene(cell: CellModel) -> Scene | None:
    """The roles of the robots; None in a cell without a camera, or without another robot."""
    try:
        return scene_of(cell)
    except RoleError:
        return None


def _tool_path(
    robot: str, states: list[RobotState], times: list[float], marks: dict[str, Marks]
) -> FigurePanel:
    """The path of a robot's tool [m], and when the gate limited it."""
    own = [(at, state.tool.position) for at, state in zip(times, states, strict=True) if state.robot == robot]
    clock, places = np.array([at for at, _ in own]), np.array([place for _, place in own]).reshape(-1, 3)
    moved = places - places[:1]
    lines = tuple(Curve(axis, clock, moved[:, k]) for k, axis in enumerate("xyz"))
    return FigurePanel(
        f"Tool of {robot}, from where it began", "m", lines, (marks[robot],) if robot in marks else ()
    )
