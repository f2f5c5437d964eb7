"""A camera controller and a leader in virtual time, through the cores of the services, recorded."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from deltaq_controllers.interface import Controller, HeldBack, RobotView, View
from deltaq_experiments.options import Options
from deltaq_experiments.scene import link_cycles, scene_of
from deltaq_experiments.trace import Trace
from deltaq_protocol.arrays import Array
from deltaq_testing.oracle import GateCounts
from deltaq_testing.recorded import virtual_cell
from deltaq_testing.virtual_cell.arm import KrcArm
from deltaq_testing.virtual_cell.cell import VirtualCell


@dataclass(frozen=True)
class RunRecord:
    """Result of a run.

    Attributes:
        trace: configurations of the robots over time.
        gate: verdicts by outcome.
        reasons: reasons by code.
        gate_by_robot: verdicts by outcome, of each robot whose verdicts were listened to.
    """

    trace: Trace
    gate: GateCounts
    reasons: dict[str, int]
    gate_by_robot: dict[str, GateCounts] = field(default_factory=dict)


def record(
    options: Options,
    camera: Controller,
    leader: Controller | None = None,
    start: Mapping[str, Array] | None = None,
    before_cycle: Callable[[float], None] | None = None,
) -> RunRecord:
    """Run the whole stack in virtual time.

    The camera controller sees its own robot's newest state and the others' as old as the link makes them; the
    leader sees the newest of all. Robots that neither watch nor are watched stand where they start.

    Args:
        options: with `length_s` known.
        camera: moves the robot with the camera.
        leader: moves the leader; None lets it stand.
        start: (n,) configuration of each robot that does not start at home [rad or m].
        before_cycle: called with the time since the start, before the controllers are asked.
    """
    with virtual_cell(options.cell, start, options.record) as stack:
        return _run(stack, options, camera, leader, before_cycle)


def _run(
    stack: VirtualCell,
    options: Options,
    camera: Controller,
    leader: Controller | None,
    before_cycle: Callable[[float], None] | None,
) -> RunRecord:
    scene = scene_of(stack.cell, options)
    cycle_s = scene.cycle_s
    late_camera = HeldBack(camera, link_cycles(scene, options.latency_s))
    stack.run_until_ready()
    stack.acquire(scene.robot_name, "camera-follower")
    if leader is not None:
        stack.acquire(scene.leader_name, "scripted-leader")
    q: dict[str, list[Array]] = {name: [] for name in stack.arms}
    setpoints: dict[str, list[Array]] = {name: [] for name in stack.arms}
    verdicts: dict[str, Counter[str]] = defaultdict(Counter)
    cycles = max(1, round(options.length_s / cycle_s))
    for cycle in range(cycles):
        stack.cycle()
        if before_cycle is not None:
            before_cycle(cycle * cycle_s)
        views = {name: RobotView.from_state(state) for name, state in stack.states.items()}
        asked = {scene.robot_name: late_camera.increment(view_of(views, scene.robot_name))}
        if leader is not None:
            asked = {scene.leader_name: leader.increment(view_of(views, scene.leader_name)), **asked}
        for name, dq in asked.items():
            verdict = stack.ask(name, dq)
            if verdict is not None:
                verdicts[name][verdict.outcome] += 1
        for name, arm in stack.arms.items():
            q[name].append(arm.q)
            setpoints[name].append(arm.krc.sample.q_setpoint if isinstance(arm, KrcArm) else arm.q)
    trace = Trace(
        np.arange(cycles, dtype=np.float64) * cycle_s,
        {name: np.array(rows) for name, rows in q.items()},
        {name: np.array(rows) for name, rows in setpoints.items()},
    )
    counters = stack.sim.counters
    reasons = {k.removeprefix("reason_"): v for k, v in counters.items() if k.startswith("reason_")}
    by_robot = {name: GateCounts.of(counts) for name, counts in verdicts.items()}
    return RunRecord(trace, GateCounts.of(counters), reasons, by_robot)


def view_of(views: Mapping[str, RobotView], robot: str) -> View:
    """The view of a robot's controller: its own robot, and the others."""
    return View(views[robot], {name: view for name, view in views.items() if name != robot})
