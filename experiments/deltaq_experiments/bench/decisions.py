"""Decisions of the gate beside raw distance calls over the same pairs: in free tracking, and near obstacles."""

import gc
import gzip
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import msgpack
import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import WORLD, composite_model
from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import make_reproducible
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.bench.rsi_reply import rsi_reply
from deltaq_experiments.bench.table import BenchRow, BenchTable
from deltaq_experiments.scene import camera_controller, scene_of
from deltaq_protocol.arrays import Array
from deltaq_protocol.codec import unpack
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import GateMemory, Request
from deltaq_services.sim.core import Decider, Sim
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.tracker import Tracker
from deltaq_testing.virtual_cell.cell import VirtualCell

PASSES = 5
"""Number of decisions of each stored situation; the median of their times counts, to exclude interference by other
programs.
"""


# Stored situations near obstacles that cost the gate most time.
#
# `python -m studies.cornered` found them. Adversaries drive both robots of the lab cell into each other and into
# the structure, over several seeds, and each decision is timed. Kept are the gate's memory before a decision and the
# request that it decided, of those that took longest.

CELL = "lab"
"""The cell that the situations are of."""
FILE = Path(__file__).with_name("cornered.msgpack.gz")


@dataclass(frozen=True)
class CorneredSituation:
    """The inputs of one decision.

    Attributes:
        memory: of the gate.
        request: the request to decide.
    """

    memory: GateMemory
    request: Request


def stored(file: Path = FILE) -> list[CorneredSituation]:
    """The stored situations.

    Raises:
        DeltaqError: if the file is damaged.
        InvalidMessageError: if its messages are not those of this version.
    """
    try:
        pairs = msgpack.unpackb(gzip.decompress(file.read_bytes()))
        split = [(bytes(memory), bytes(request)) for memory, request in pairs]
    except (OSError, EOFError, ValueError, TypeError) as error:
        raise DeltaqError(f"{file} holds no situations: {error}; write it anew") from error
    return [CorneredSituation(unpack(GateMemory, one), unpack(Request, other)) for one, other in split]


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


def run(
    cell_name: str | Path = "lab", cycles: int = 400, on_cycle: Callable[[int, int], None] | None = None
) -> BenchTable:
    """All rows of `deltaq bench`.

    Args:
        cell_name: cell with a camera robot `fr` and a leader `gr`, whose decisions are timed while the camera tracks;
            the other rows are of shipped cells.
        cycles: cycles of tracking.
        on_cycle: called with the number of cycles done and the number of all.
    """
    return BenchTable(
        rows=(
            rsi_reply(),
            tracking(cell_name, cycles, on_cycle or (lambda _done, _of: None)),
            near_obstacles(),
        )
    )
