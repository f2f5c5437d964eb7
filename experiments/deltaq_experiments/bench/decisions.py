"""Decisions of the gate beside raw distance calls over the same pairs: in free tracking, and near obstacles."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import WORLD, composite_model
from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import make_reproducible
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.bench.cornered import CELL, CorneredSituation, stored
from deltaq_experiments.bench.table import BenchRow
from deltaq_experiments.scene import camera_controller, scene_of
from deltaq_protocol.arrays import Array
from deltaq_services.sim.core import Decider, Sim
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.tracker import Tracker
from deltaq_testing.virtual_cell.cell import VirtualCell

PASSES = 5
"""Number of decisions of each stored situation; the median of their times counts, to exclude interference by other
programs.
"""


clock = time.thread_time
"""Processor time of this thread [s], to exclude time taken by other programs."""


class Stopwatch:
    """Times every decision of a gate.

    Attributes:
        seconds: processor time of each.
    """

    def __init__(self, gate: Decider) -> None:
        self.seconds: list[float] = []
        self._gate = gate

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        """Decide one request."""
        begin = clock()
        decision = self._gate.decide(robot, others, request)
        self.seconds.append(clock() - begin)
        return decision


class RawDistances:
    """The reference: one `pinocchio.computeDistances` over every pair that the gate checks.

    Args:
        cell: the cell.

    Attributes:
        pairs: how many.
    """

    def __init__(self, cell: CellModel) -> None:
        self._model, places = composite_model(cell)
        self._geometry = pin.GeometryModel()
        for name, robot in cell.robots.items():
            for body in robot.geometry.geometryObjects:
                self._geometry.addGeometryObject(places[name].moved(body))
        for body in cell.structure:
            self._geometry.addGeometryObject(body)
        never = {frozenset(pair) for robot in cell.robots.values() for pair in robot.never_checked_pairs()}
        for (i, first), (j, second) in combinations(enumerate(self._geometry.geometryObjects), 2):
            moves = first.parentJoint != WORLD or second.parentJoint != WORLD
            if moves and frozenset((first.name, second.name)) not in never:
                self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._names = tuple(cell.robots)
        self._data, self._geometry_data = self._model.createData(), self._geometry.createData()
        make_reproducible(self._geometry_data)
        self.pairs = len(self._geometry.collisionPairs)

    def seconds(self, configurations: dict[str, Array]) -> float:
        """Processor time of one call [s]; the placements are not timed."""
        q = np.concatenate([configurations[name] for name in self._names])
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        begin = clock()
        pin.computeDistances(self._geometry, self._geometry_data)
        return clock() - begin


def tracking(cell_name: str | Path, cycles: int, on_cycle: Callable[[int, int], None]) -> BenchRow:
    """Every decision while the camera tracks at 0.25 m/s.

    Args:
        cell_name: cell in which a robot with a camera watches another one.
        cycles: of tracking.
        on_cycle: called with the number of cycles done and the number of all.
    """
    stack = VirtualCell(cell_name)
    raw = RawDistances(stack.cell)
    scene = scene_of(stack.cell)
    leader = ScriptedLeader(scene.leader, scene.cycle_s, 0.25, 0)
    camera = camera_controller(scene)
    stopwatch = Stopwatch(stack.sim.gate)
    stack.sim.gate = stopwatch
    references: list[float] = []
    stack.run_until_ready()
    stack.acquire(scene.leader_name, "bench")
    stack.acquire(scene.robot_name, "bench")
    gc.collect()
    for cycle in range(cycles):
        stack.cycle()
        states = {name: RobotView.from_state(state) for name, state in stack.states.items()}
        stack.ask(scene.leader_name, leader.increment(View(states[scene.leader_name])))
        stack.ask(scene.robot_name, camera.increment(View(states[scene.robot_name], states)))
        references.append(raw.seconds({name: state.q_cmd for name, state in states.items()}))
        on_cycle(cycle + 1, cycles)
    return BenchRow.of(
        "one gate decision, tracking at 0.25 m/s",
        f"one computeDistances over the same {raw.pairs} pairs",
        stopwatch.seconds,
        references,
        at_most=0.3,
        p99_9_at_most=1.0,
    )


def near_obstacles(situations: Sequence[CorneredSituation] | None = None, passes: int = PASSES) -> BenchRow:
    """Decisions in situations in which the gate had most to do; the stored ones unless others are given."""
    situations = stored() if situations is None else situations
    cell = CellModel.load(CELL)
    sim, raw = Sim(cell, epoch=0), RawDistances(cell)
    stopwatch = Stopwatch(sim.gate)
    sim.gate = stopwatch
    references = []
    gc.collect()
    for situation in situations:
        for _ in range(passes):
            sim.restore(situation.memory)
            sim.take(situation.request)
        states = {name: robot.tracker.state for name, robot in sim.robots.items()}
        q_cmd = {name: np.array(state.q_cmd) for name, state in states.items() if state is not None}
        references.append(float(np.median([raw.seconds(q_cmd) for _ in range(passes)])))
    seconds = np.median(np.reshape(stopwatch.seconds, (len(situations), passes)), axis=1).tolist()
    return BenchRow.of(
        f"one gate decision near obstacles, {len(situations)} stored situations",
        f"one computeDistances over the same {raw.pairs} pairs",
        seconds,
        references,
        longest_at_most=2.0,
    )
