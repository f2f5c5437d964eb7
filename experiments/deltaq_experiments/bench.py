"""Figures as ratios, each against its reference in the same run: `deltaq bench`."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict

from deltaq_cell.cell_model import CellModel
from deltaq_cell.composite_model import WORLD, composite_model
from deltaq_cell.group import make_reproducible
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.scene import FOLLOWER, LEADER, camera_controller
from deltaq_protocol.arrays import Array
from deltaq_services.sim.core import Decider
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.tracker import Tracker
from deltaq_verification.virtual_cell.cell import VirtualCell


class BenchRow(BaseModel):
    """One figure beside its reference."""

    model_config = ConfigDict(frozen=True)

    what: str
    reference: str
    median_us: float
    reference_us: float
    median_ratio: float
    p99_ratio: float
    at_most: float
    """Bound of the median ratio."""


class BenchTable(BaseModel):
    """All figures of one run."""

    model_config = ConfigDict(frozen=True)

    rows: tuple[BenchRow, ...]

    @property
    def good(self) -> bool:
        """Whether every median keeps its bound."""
        return all(row.median_ratio <= row.at_most for row in self.rows)


def run(
    cell_name: str | Path = "lab", cycles: int = 400, on_cycle: Callable[[int, int], None] | None = None
) -> BenchTable:
    """Measure.

    Args:
        cell_name: cell with a camera robot `fr` and a leader `gr`.
        cycles: cycles of tracking at 0.25 m/s in which every decision is timed.
        on_cycle: called with the number of cycles done and the number of all.
    """
    stack = VirtualCell(cell_name)
    raw = RawDistances(stack.cell)
    cycle_s = stack.cell.description.cycle_s
    leader = ScriptedLeader(stack.cell.robots[LEADER], cycle_s, 0.25, 0)
    camera = camera_controller(stack.cell)
    stopwatch = Stopwatch(stack.sim.gate)
    stack.sim.gate = stopwatch
    references: list[float] = []
    stack.run_until_ready()
    stack.acquire(LEADER, "bench")
    stack.acquire(FOLLOWER, "bench")
    gc.collect()
    for cycle in range(cycles):
        stack.cycle()
        states = {name: RobotView.from_state(state) for name, state in stack.states.items()}
        stack.ask(LEADER, leader.increment(View(states[LEADER])))
        stack.ask(FOLLOWER, camera.increment(View(states[FOLLOWER], states)))
        references.append(raw.seconds({name: state.q_cmd for name, state in states.items()}))
        if on_cycle is not None:
            on_cycle(cycle + 1, cycles)
    return BenchTable(rows=(_row(stopwatch.seconds, references, raw.pairs),))


class Stopwatch:
    """Times every decision of a gate.

    Attributes:
        seconds: duration of each.
    """

    def __init__(self, gate: Decider) -> None:
        self.seconds: list[float] = []
        self._gate = gate

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        """Decide one request."""
        begin = time.perf_counter()
        decision = self._gate.decide(robot, others, request)
        self.seconds.append(time.perf_counter() - begin)
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
        """Time of one call [s]; the placements are not timed."""
        q = np.concatenate([configurations[name] for name in self._names])
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        begin = time.perf_counter()
        pin.computeDistances(self._geometry, self._geometry_data)
        return time.perf_counter() - begin


def _row(decisions: list[float], references: list[float], pairs: int) -> BenchRow:
    reference = float(np.median(references))
    return BenchRow(
        what="one gate decision, tracking at 0.25 m/s",
        reference=f"one computeDistances over the same {pairs} pairs",
        median_us=float(np.median(decisions)) * 1e6,
        reference_us=reference * 1e6,
        median_ratio=float(np.median(decisions)) / reference,
        p99_ratio=float(np.percentile(decisions, 99)) / float(np.percentile(references, 99)),
        at_most=5.0,
    )
