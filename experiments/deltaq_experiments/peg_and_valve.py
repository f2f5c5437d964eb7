"""A peg and a valve in each mode: which mode is for which task, in figures.

The hand goes to a hole, puts a peg in along the hole's axis and takes it out, goes to a valve and turns it. Hole and
valve are in free space: the motion is measured, not a contact. All of it passes the whole stack in
virtual time, steered by operators that are programs (`peg_and_valve_operators`) and make mistakes
(`peg_and_valve_operators.Person`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic import BaseModel

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.session import AdvisorSession, SynchronousAdvisor
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.inverse.tracking import first_redundant
from deltaq_controllers.live import model_of
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import MODES, Teleoperator
from deltaq_experiments.peg_and_valve_operators import (
    HAND_M_S,
    HAND_RAD_S,
    JOINT_M_S,
    JOINT_RAD_S,
    AdvisedOperator,
    HandGoal,
    HandOperator,
    JointOperator,
    OperatorHand,
    Person,
    PostureOperator,
    ScriptedOperator,
    error_to,
)
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import HAND_AXES, DrivingMode, OperatorCommand
from deltaq_testing.virtual_cell.cell import VirtualCell

PEG_M = 0.1
TURN_RAD = np.deg2rad(60.0)
LONGEST_S = 600.0

PLACED_M, TILTED_RAD = 0.05, np.deg2rad(10.0)
"""How far hole and valve are from their usual places, at most: a cube's half side, and an angle about any axis."""

OFF_MM, TILT_DEG = 3.0, 1.0
"""In place of a contact: a peg farther off the hole's axis, or more tilted, would touch, and so would a hand farther
off a valve. An assumption, as wide as a bolt's hole that was drilled for a robot."""

OPERATORS: dict[str, Callable[[Teleoperator, float, float], ScriptedOperator]] = {
    "joint": lambda teleoperator, cycle_s, reaction_s: JointOperator(teleoperator.robot, cycle_s, reaction_s),
    "decoupled": lambda teleoperator, cycle_s, reaction_s: HandOperator(
        teleoperator.robot, cycle_s, reaction_s, DrivingMode.DECOUPLED
    ),
    "self-motion": lambda teleoperator, cycle_s, reaction_s: PostureOperator(
        teleoperator.robot, cycle_s, reaction_s
    ),
    "advisor": AdvisedOperator,
    "coupled": lambda teleoperator, cycle_s, reaction_s: HandOperator(
        teleoperator.robot, cycle_s, reaction_s, DrivingMode.COUPLED
    ),
}
"""`self-motion` and `advisor` are decoupled mode with a change of posture before each piece of work."""


class ModeFigures(BaseModel, frozen=True):
    """The task in one mode, once.

    Attributes:
        mode: the mode.
        seed: of the places of hole and valve, and of the operator.
        undone: why the task was not completed; empty if it was. The other figures are of the completed part.
        time_s: for the whole task.
        reach_s: for going to the hole and to the valve.
        insert_s: for putting the peg in.
        turn_s: for turning the valve.
        peg_off_mm: greatest distance of the peg from the hole's axis, in and out.
        peg_tilt_deg: greatest angle between them.
        valve_off_mm: greatest distance of the hand from the valve while it turns.
        kept: share of the time at work within `OFF_MM` and `TILT_DEG`.
        end_mm: distance from the goal at the end, the mean of all goals.
        end_deg: the same, angle.
        limit_margin: least distance of a joint from its limit at the goals, over half its range.
        reaction_s: of the operator.
        slips: of the operator, by kind.
        gate: verdicts by outcome.
    """

    mode: str
    seed: int
    undone: str
    time_s: float
    reach_s: float
    insert_s: float
    turn_s: float
    peg_off_mm: float
    peg_tilt_deg: float
    valve_off_mm: float
    kept: float
    end_mm: float
    end_deg: float
    limit_margin: float
    reaction_s: float
    slips: dict[str, int]
    gate: dict[str, int]


def goals(home: Array, generator: np.random.Generator) -> list[HandGoal]:
    """The task, from the hand's home pose T_world_tool (4, 4), hole and valve placed at random."""
    hole = _shifted(_moved(home, (0.15, -0.2, 0.0), (0.0, 0.0, np.deg2rad(20.0))), generator)
    inside = hole.copy()
    inside[:3, 3] += PEG_M * hole[:3, 2]
    valve = _shifted(_moved(home, (-0.15, 0.15, 0.05), (np.deg2rad(15.0), 0.0, 0.0)), generator)
    turned = valve.copy()
    turned[:3, :3] = valve[:3, :3] @ pin.exp3(np.array([0.0, 0.0, TURN_RAD]))
    return [
        HandGoal("reach the hole", hole),
        HandGoal("insert", inside, steps=10),
        HandGoal("retract", hole, steps=10),
        HandGoal("reach the valve", valve),
        HandGoal("turn", turned, steps=10),
    ]


def run(
    cell: str | Path = "lab",
    robot: str | None = None,
    modes: Sequence[str] = tuple(OPERATORS),
    seeds: Sequence[int] = (0,),
    progress: Callable[[int, int], None] | None = None,
) -> list[ModeFigures]:
    """Do the task in each mode, once a seed.

    Args:
        cell: the cell.
        robot: a redundant robot of it with one hand; None: its first.
        modes: the modes.
        seeds: of the places of hole and valve, and of the operator; all modes have the same.
        progress: called with the tasks done and their number.

    Raises:
        ControllerError: there is no such mode or robot.
        CellError: there is no such cell.
    """
    unknown = [mode for mode in modes if mode not in OPERATORS]
    if unknown:
        raise ControllerError(f"no mode {unknown[0]!r} for this task; there are {', '.join(OPERATORS)}")
    robot = robot or robot_for_the_task(cell)
    figures: list[ModeFigures] = []
    for seed in seeds:
        for mode in modes:
            if progress is not None:
                progress(len(figures), len(seeds) * len(modes))
            figures.append(once(cell, robot, mode, seed))
    return figures


def robot_for_the_task(cell: str | Path) -> str:
    """The first redundant robot of a cell that has one hand.

    Raises:
        ControllerError: there is none.
        CellError: there is no such cell.
    """
    model = CellModel.load(cell)
    tracker = first_redundant(model.robots, most_hands=1)
    if tracker is None:
        raise ControllerError(
            f"cell {model.description.cell} has no redundant robot with one hand; the task is for one"
        )
    return tracker.robot.name


def once(cell: str | Path, robot: str, mode: str, seed: int) -> ModeFigures:
    """Do the task in one mode.

    Raises:
        ControllerError: there is no such robot.
    """
    return _Run(cell, robot, mode, seed).figures()


class _UndoneError(Exception):
    """The task takes too long."""


class _Run:
    def __init__(self, cell: str | Path, robot: str, mode: str, seed: int) -> None:
        self._stack = VirtualCell(cell)
        self._cycle_s = self._stack.cell.description.cycle_s
        self._robot = model_of(self._stack.cell.robots, robot)
        if len(self._robot.hands) > 1:
            raise ControllerError(
                f"the task is for one hand, robot {robot!r} has {', '.join(self._robot.hands)}"
            )
        self._name, self._mode, self._seed = robot, mode, seed
        self._teleoperator = Teleoperator(
            self._robot, self._cycle_s, modes={**MODES, DrivingMode.ADVISOR: self._advisor}
        )
        places, person, hand = (np.random.default_rng([seed, stream]) for stream in range(3))
        self._goals = goals(self._robot.forward(self._robot.home), places)
        self._person = Person.drawn(person)
        self._hand = OperatorHand(self._person, self._cycle_s, hand)
        self._operator = OPERATORS[mode](self._teleoperator, self._cycle_s, self._person.reaction_s)
        self._stack.run_until_ready()
        self._stack.acquire(robot, "operator")
        self._cycles = 0

    def _advisor(self, robot: RobotModel) -> AdvisorMode:
        return AdvisorMode(
            robot, self._cycle_s, SynchronousAdvisor(AdvisorSession(self._stack.cell, robot.name))
        )

    def figures(self) -> ModeFigures:
        """Do the task until its end or its first failure."""
        ways: dict[str, list[Array]] = {}
        undone = ""
        try:
            for goal in self._goals:
                self._to(goal, ways.setdefault(goal.name, []))
        except _UndoneError as error:
            undone = str(error)
        done = [goal for goal in self._goals if ways.get(goal.name)]
        ends = [error_to(goal.pose, self._robot.forward(ways[goal.name][-1])).reshape(2, 3) for goal in done]
        off = np.linalg.norm(ends, axis=2).mean(axis=0)
        hole, valve = (goal.pose for goal in self._goals[2:4])
        inside = [q for name in ("insert", "retract") for q in ways.get(name, [])]
        peg = np.array([_off_axis(hole, self._robot.forward(q)) for q in inside]).reshape(-1, 2)
        peg *= (1000.0, np.rad2deg(1.0))
        turn = np.array([self._robot.forward(q)[:3, 3] for q in ways.get("turn", [])]).reshape(-1, 3)
        turn_mm = 1000.0 * np.linalg.norm(turn - valve[:3, 3], axis=1)
        within = np.append((peg[:, 0] <= OFF_MM) & (peg[:, 1] <= TILT_DEG), turn_mm <= OFF_MM)
        seconds = {goal.name: len(ways.get(goal.name, [])) * self._cycle_s for goal in self._goals}
        return ModeFigures(
            mode=self._mode,
            seed=self._seed,
            undone=undone,
            time_s=self._cycles * self._cycle_s,
            reach_s=seconds["reach the hole"] + seconds["reach the valve"],
            insert_s=seconds["insert"],
            turn_s=seconds["turn"],
            peg_off_mm=float(peg[:, 0].max(initial=0.0)),
            peg_tilt_deg=float(peg[:, 1].max(initial=0.0)),
            valve_off_mm=float(turn_mm.max(initial=0.0)),
            kept=float(within.mean()) if len(within) else 0.0,
            end_mm=1000 * float(off[0]),
            end_deg=float(np.rad2deg(off[1])),
            limit_margin=min(self._margin(ways[goal.name][-1]) for goal in done),
            reaction_s=self._person.reaction_s,
            slips={kind.value: count for kind, count in self._hand.slips.items()},
            gate={
                outcome: self._stack.sim.counters[outcome]
                for outcome in ("admitted", "scaled", "held", "refused")
            },
        )

    def _to(self, goal: HandGoal, way: list[Array]) -> None:
        """Append the measured configurations on the path to a goal."""
        while True:
            self._stack.cycle()
            self._cycles += 1
            view = RobotView.from_state(self._stack.states[self._name])
            way.append(view.q)
            meant = self._operator.command(view.q, goal)
            if meant is None:
                return
            self._teleoperator.command = self._hand.done(meant, self._axes(meant), self._options())
            increment = self._teleoperator.increment(View(view))
            self._teleoperator.take_verdict(self._stack.ask(self._name, increment))
            if self._cycles * self._cycle_s > LONGEST_S:
                limit = self._teleoperator.limitation
                raise _UndoneError(f"'{goal.name}' is not done after {LONGEST_S:g} s; limited by {limit}")

    def _axes(self, meant: OperatorCommand) -> Mapping[str, float]:
        """The axes of the operator's device, those of the hand or of the joints, and their greatest rates."""
        if not meant.rates:
            return {}
        if set(meant.rates) <= set(HAND_AXES):
            return {axis: HAND_RAD_S if axis.startswith("r") else HAND_M_S for axis in HAND_AXES}
        joints = zip(self._robot.joint_names, self._robot.revolute, strict=True)
        return {joint: JOINT_RAD_S if turns else JOINT_M_S for joint, turns in joints}

    def _options(self) -> int:
        if self._teleoperator.mode is not DrivingMode.ADVISOR:
            return 0
        mode = self._teleoperator.mode_named(DrivingMode.ADVISOR)
        assert isinstance(mode, AdvisorMode)
        return len(mode.options)

    def _margin(self, q: Array) -> float:
        lower, upper = self._robot.lower, self._robot.upper
        return float(np.min(np.minimum(q - lower, upper - q) / (upper - lower)) * 2)


def _moved(pose: Array, offset_m: tuple[float, float, float], turn_rad: tuple[float, float, float]) -> Array:
    moved = pose.copy()
    moved[:3, 3] += offset_m
    moved[:3, :3] = pin.exp3(np.array(turn_rad)) @ pose[:3, :3]
    return moved


def _shifted(pose: Array, generator: np.random.Generator) -> Array:
    axis = generator.normal(size=3)
    turn = generator.uniform(-TILTED_RAD, TILTED_RAD) * axis / np.linalg.norm(axis)
    x, y, z = generator.uniform(-PLACED_M, PLACED_M, 3).tolist()
    return _moved(pose, (x, y, z), tuple(turn.tolist()))


def _off_axis(hole: Array, pose: Array) -> tuple[float, float]:
    """Distance of a peg's tip from the hole's axis [m], and the angle between the axes [rad]."""
    axis, offset = hole[:3, 2], pose[:3, 3] - hole[:3, 3]
    across = offset - (offset @ axis) * axis
    sine = np.linalg.norm(np.cross(axis, pose[:3, 2]))
    return float(np.linalg.norm(across)), float(np.arctan2(sine, axis @ pose[:3, 2]))


# The figures of some runs, as tables and JSON have them.


@dataclass(frozen=True)
class Figure:
    """One figure of a run, with its name in tables.

    Attributes:
        name: its name with its unit.
        of: computes it from one run.
        decimals: number of decimals to print.
        worst: selects the worst of several values.
    """

    name: str
    of: Callable[[ModeFigures], float]
    decimals: int = 1
    worst: Callable[[Sequence[float]], float] = max

    def told(self, runs: Sequence[ModeFigures]) -> dict[str, Any]:
        """Median, lower and upper quartile, worst, and its seed."""
        values = [self.of(run) for run in runs]
        worst = self.worst(values)
        # of one run, all three are that one
        lower, _, upper = quantiles(values * 2 if len(values) == 1 else values, n=4, method="inclusive")
        return {
            "median": median(values),
            "quartiles": [lower, upper],
            "worst": worst,
            "seed": runs[values.index(worst)].seed,
        }

    def cell(self, runs: Sequence[ModeFigures]) -> str:
        """The median and the worst with its seed, as text for a table."""
        told = self.told(runs)
        middle, lower, upper, worst = (
            f"{value:.{self.decimals}f}" for value in (told["median"], *told["quartiles"], told["worst"])
        )
        return f"{middle} [{lower}, {upper}]; {worst} ({told['seed']})"


FIGURES = (
    Figure("task, s", lambda run: run.time_s, 0),
    Figure("peg off its axis, mm", lambda run: run.peg_off_mm),
    Figure("peg tilted, °", lambda run: run.peg_tilt_deg, 2),
    Figure("valve off its axis, mm", lambda run: run.valve_off_mm),
    Figure("within tolerance, % of the time at work", lambda run: 100 * run.kept, 0, min),
    Figure("least margin to a joint limit, %", lambda run: 100 * run.limit_margin, 0, min),
    Figure("slips", lambda run: sum(run.slips.values()), 0),
)


def by_mode(runs: Sequence[ModeFigures]) -> dict[str, list[ModeFigures]]:
    """The runs of each mode that has any, in the paper's order."""
    found = {mode: [run for run in runs if run.mode == mode] for mode in OPERATORS}
    return {mode: ours for mode, ours in found.items() if ours}


def distributions(runs: Sequence[ModeFigures]) -> list[dict[str, Any]]:
    """For each mode: number of runs, number of finished runs, and the distribution of every figure."""
    return [
        {
            "mode": mode,
            "runs": len(ours),
            "done": sum(not run.undone for run in ours),
            "figures": {figure.name: figure.told(ours) for figure in FIGURES},
        }
        for mode, ours in by_mode(runs).items()
    ]
