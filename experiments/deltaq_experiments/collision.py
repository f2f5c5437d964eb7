"""The paper's collision avoidance (VI-E, Fig. 11): the leader tries to hit the follower; the focus is fixed."""

import math
import time
from collections.abc import Mapping
from itertools import count

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.controllers import FocusController
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import Controller, HeldBack, RobotView, View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.leader.attacking import TARGETS, AttackingLeader, HomingStick, staging_box
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_emulator.drives import Servo
from deltaq_experiments.figures import Curve, FigurePanel, Marks, distance_panel
from deltaq_experiments.live import run_live
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome, Report
from deltaq_experiments.scene import (
    LEAST_CLEARANCE_M,
    VIEW_DISTANCE_M,
    MeasuredView,
    camera_controller,
    link_cycles,
    load,
    start_with_error,
)
from deltaq_experiments.seen import CameraRun, seen, summary
from deltaq_experiments.trace import Trace
from deltaq_experiments.virtual import RunRecord, record, view_of
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.oracle import ClearanceOracle, GateCounts

# How hard an attack presses: in which share of the time the attacker could move as it wanted.

HELD_BELOW = 0.1
"""An attacker's tool below this part of its requested speed is held, by the gate or by its own limits."""


class Pressing:
    """An attacker that is looked at while it attacks.

    Args:
        leader: the attacker.
        model: of its robot.
        cycle_s: its cycle [s].
    """

    def __init__(self, leader: AttackingLeader, model: RobotModel, cycle_s: float) -> None:
        self._leader, self._cycle_s = leader, cycle_s
        self._tool = Kinematics(model, "tool")
        self._last: Array | None = None
        self._attacked = self._moved = 0

    def increment(self, view: View) -> Array:
        """The attacker's increment for this cycle, (n,) [rad or m]."""
        self._tool.update(view.own.q_cmd)
        tip, asked_m_s = self._tool.position, float(np.linalg.norm(self._leader.asked_m_s))
        if (
            self._last is not None
            and self._leader.attacking
            and asked_m_s > HELD_BELOW * self._leader.speed_m_s
        ):
            self._attacked += 1
            self._moved += bool(np.linalg.norm(tip - self._last) >= HELD_BELOW * asked_m_s * self._cycle_s)
        self._last = tip
        return self._leader.increment(view)

    @property
    def share(self) -> float | None:
        """Part of the attacking cycles in which it moved; None if it never attacked."""
        return self._moved / self._attacked if self._attacked else None


# Where an attack begins: both robots somewhere else with every seed.

LOOKS_PAST_RAD = math.radians(20.0)
"""By how much the camera misses its focus: it looks there before the first attack has come near."""

_ON_THE_WAY_S = 3.0
_SPEED_M_S = 0.5


def attack_start(scene: Scene, camera: MeasuredView, seed: int) -> dict[str, Array]:
    """Configurations (n,) of both robots [rad or m].

    The leader's tool is at a random point of its retreat box, and the follower's camera looks nearly at its focus.

    Args:
        scene: the roles of the robots.
        camera: measures the view.
        seed: of both.

    Raises:
        DeltaqError: no such configuration of the follower is found.
    """
    oracle, box = ClearanceOracle(scene.cell), staging_box(scene.leader)
    at_home = {name: one.home for name, one in scene.cell.robots.items()}
    for attempt in count():
        follower_seed = seed if attempt == 0 else int(np.random.default_rng((seed, attempt)).integers(2**31))
        q = start_with_error(scene, camera, LOOKS_PAST_RAD, follower_seed)
        point = np.random.default_rng((seed, 1 + attempt)).uniform(box.low, box.high)
        both = {scene.robot_name: q, scene.leader_name: _with_tool_at(scene, point)}
        if oracle.between_robots_and_structure(at_home | both).distance_m > 0.5 * LEAST_CLEARANCE_M:
            return both
    raise AssertionError  # count() does not end


def _with_tool_at(scene: Scene, point: Array) -> Array:
    """(n,) the leader as it arrives from home with its tool at a point (3,) [rad or m]."""
    model, cycle_s = scene.leader, scene.cycle_s
    stick = HomingStick(_SPEED_M_S, cycle_s)
    stick.point = point
    leader, q = ScriptedLeader(model, cycle_s, stick=stick), np.array(model.home)
    for cycle in range(round(_ON_THE_WAY_S / cycle_s)):
        q = q + leader.increment(View(RobotView(cycle, cycle * cycle_s, q, q)))
    return q


# A camera controller and a leader without a gate: the drives execute the controllers' increments unchanged.
#
# Only the limits that the controllers themselves keep are left. The drives lag as those of the emulated
# controllers.


class _Arm:
    """A robot that goes where it is sent."""

    def __init__(self, robot: RobotModel, cycle_s: float, q: Array) -> None:
        self._servo = Servo(q, robot.description.servo_lag, cycle_s)
        self._setpoint, self._cycle_s = q.copy(), cycle_s
        self.q: list[Array] = []
        self.setpoints: list[Array] = []

    def seen(self, cycle: int) -> RobotView:
        return RobotView(cycle, cycle * self._cycle_s, self._servo.q.copy(), self._setpoint.copy())

    def go(self, dq: Array) -> None:
        self._setpoint = self._setpoint + dq
        self._servo.advance(self._setpoint)
        self.q.append(self._servo.q.copy())
        self.setpoints.append(self._setpoint)


def record_ungated(
    options: Options, scene: Scene, camera: Controller, leader: Controller, start: Mapping[str, Array]
) -> RunRecord:
    """Run them without services.

    Args:
        options: with `length_s` known.
        scene: the roles of the robots; other robots of the cell are at rest.
        camera: moves the robot with the camera; it gets the others' states delayed by the link.
        leader: moves the leader; it gets the others' newest states.
        start: (n,) configuration of each robot that does not start at home [rad or m].
    """
    cycle_s = scene.cycle_s
    late_camera = HeldBack(camera, link_cycles(scene, options.latency_s))
    robots = scene.cell.robots
    arms = {name: _Arm(robot, cycle_s, start.get(name, robot.home)) for name, robot in robots.items()}
    cycles = max(1, round(options.length_s / cycle_s))
    for cycle in range(cycles):
        views = {name: arm.seen(cycle) for name, arm in arms.items()}
        asked = {name: np.zeros(robot.n) for name, robot in robots.items()}
        asked[scene.leader_name] = leader.increment(view_of(views, scene.leader_name))
        asked[scene.robot_name] = late_camera.increment(view_of(views, scene.robot_name))
        for name, arm in arms.items():
            arm.go(asked[name])
    trace = Trace(
        np.arange(cycles, dtype=np.float64) * cycle_s,
        {name: np.array(arm.q) for name, arm in arms.items()},
        {name: np.array(arm.setpoints) for name, arm in arms.items()},
    )
    return RunRecord(trace, GateCounts(), {})


DURATION_S = 40.0


class CollisionReport(Report):
    """The common figures, and the outcome of the attacks.

    Attributes:
        target: the part that they homed in on.
        contacts: cycles in which bodies of the two robots touched.
        evading_share: fraction of the cycles in which the follower evaded.
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
        DeltaqError: if the cell has no such robots, or there is no such target.
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
    recording = _recorded(options, scene, focus, camera, attacker)
    elapsed_s = time.perf_counter() - began_s
    trace = recording.trace
    views = trace.views(camera, scene)
    between = trace.robot_clearances(scene.cell)
    evading = trace.clearances(camera, scene) < camera.evades_below_m
    looks = seen(scene, trace, lambda _q_leader: focus)
    run = CameraRun(recording, views[:, 0], views[:, 1] - VIEW_DISTANCE_M, looks)
    report = CollisionReport(
        **summary("collision", options, scene, elapsed_s, run),
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


def _recorded(
    options: Options, scene: Scene, focus: Array, camera: FocusController, attacker: Pressing
) -> RunRecord:
    if options.live:
        following = ["--focus-m", *(f"{value:.9f}" for value in focus)]
        return run_live(options, scene, following, ["--attack", scene.robot_name, "--target", options.target])
    start = attack_start(scene, camera, options.seed)
    if options.gated:
        return record(options, camera, attacker, start)
    return record_ungated(options, scene, camera, attacker, start)


def _panels(
    recording: RunRecord, views: Array, between: Array, evading: NDArray[np.bool_], hidden: Marks
) -> tuple[FigurePanel, ...]:
    clock = recording.trace.time_s
    marks = (Marks("F_rep acts", clock, evading),)
    return (
        FigurePanel("View angle error", "deg", (Curve("", clock, views[:, 0]),), (*marks, hidden), bound=1.0),
        distance_panel(clock, views[:, 1], VIEW_DISTANCE_M, marks),
        FigurePanel("Clearance between the robots", "m", (Curve("", clock, between),)),
    )
