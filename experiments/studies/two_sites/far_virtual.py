"""Leader and camera follower far away, in virtual time and through the cores of the services."""

import argparse
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import Controller
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.report import Figures
from deltaq_experiments.scene import VIEW_DISTANCE_M, camera_controller, scene_of
from deltaq_experiments.trace import Trace
from deltaq_protocol.arrays import Array
from deltaq_testing.oracle import GateCounts
from deltaq_testing.virtual_cell.cell import VirtualCell
from studies.two_sites.far_controller import FarController, FarWire, Watcher
from studies.two_sites.sites import write_cell


def follow_in_virtual_time(
    given: argparse.Namespace, before_cycle: Callable[[VirtualCell, Sequence[FarWire]], None] | None = None
) -> dict[str, Any]:
    """Run the cell of two sites with both controllers behind wires that are late and lossy; the figures.

    Args:
        given: the options of `studies.two_sites`.
        before_cycle: called before each cycle with the cell and the wires, which it may cut.
    """
    with tempfile.TemporaryDirectory() as folder:
        stack = VirtualCell(write_cell(Path(folder), given.transport))
    scene = scene_of(stack.cell)
    camera, cycle_s = camera_controller(scene, given.controller), scene.cycle_s
    leader = ScriptedLeader(scene.leader, cycle_s, given.leader_speed_m_s, given.seed)
    stack.run_until_ready()
    wires = _connect(stack, given, {scene.robot_name: camera, scene.leader_name: leader})
    q: dict[str, list[Array]] = {name: [] for name in stack.arms}
    setpoints: dict[str, list[Array]] = {name: [] for name in stack.arms}
    cycles = round(given.duration_s / cycle_s)
    for _ in range(cycles):
        if before_cycle is not None:
            before_cycle(stack, wires)
        stack.cycle()
        for name, arm in stack.krc_arms.items():
            q[name].append(arm.krc.sample.q)
            setpoints[name].append(arm.krc.sample.q_setpoint)
    trace = Trace(
        np.arange(cycles) * cycle_s,
        {name: np.array(rows) for name, rows in q.items()},
        {name: np.array(rows) for name, rows in setpoints.items()},
    )
    admitted = {name: arm.server.counters["admissions"] / cycles for name, arm in stack.arms.items()}
    return {
        "messages_lost": sum(wire.lost for wire in wires),
        **figures_of(trace, scene, given),
        "admission_rate": admitted,
        "phases": {name: state.phase for name, state in stack.states.items()},
        "reasons": {name: state.reason for name, state in stack.states.items()},
        "limits": trace.limit_counts(stack.cell).model_dump(),
        "gate": GateCounts.of(stack.sim.counters).model_dump(),
    }


def figures_of(trace: Trace, scene: Scene, given: argparse.Namespace) -> dict[str, Any]:
    """How far the camera was off, and how near the robots came."""
    views = trace.views(camera_controller(scene, given.controller), scene)
    settled = trace.time_s >= given.settle_s
    return {
        "cycles": len(trace.time_s),
        "leader_reached_m_s": trace.reached_speed(scene.leader, given.settle_s).model_dump(),
        "angle_deg": Figures.of(np.abs(views[:, 0]), settled).model_dump(),
        "distance_cm": Figures.of(100 * np.abs(views[:, 1] - VIEW_DISTANCE_M), settled).model_dump(),
        "robots_clearance_m": float(trace.robot_clearances(scene.cell).min(initial=np.inf)),
    }


def _connect(
    stack: VirtualCell, given: argparse.Namespace, controllers: dict[str, Controller]
) -> list[FarWire]:
    # two robots' states share a connection
    spacing_s, seeds = stack.cell.description.cycle_s / len(controllers), count(100 * given.seed)
    wires: list[FarWire] = []

    def wire() -> FarWire:
        link = given.delay_s, given.jitter_s, given.loss_share, spacing_s, next(seeds)
        wires.append(FarWire(given.transport == "tcp+udp", *link))
        return wires[-1]

    watchers: dict[str, Watcher] = {}
    for name in controllers:
        watcher = stack.connect(partial(Watcher, robot=name), down=wire()).core
        assert isinstance(watcher, Watcher)  # just made
        watchers[name] = watcher
    for name, controller in controllers.items():
        (other,) = (watchers[one] for one in controllers if one != name)
        begin = partial(FarController, robot=name, controller=controller, other=other)
        stack.connect(begin, up=wire(), down=wire())
    return wires
