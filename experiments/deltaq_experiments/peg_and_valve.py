"""A peg and a valve in each mode: which mode is for which task, in figures.

The hand goes to a hole, puts a peg in along the hole's axis and takes it out, goes to a valve and turns it. Hole and
valve are in free space: the motion is measured, not a contact. All of it passes the whole stack in
virtual time, steered by operators that are programs (`peg_and_valve_operators`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.synchronous import SynchronousAdvisor
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.live import model_of
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.motion import ModeName
from deltaq_controllers.modes.teleoperator import MODES, Teleoperator
from deltaq_experiments.peg_and_valve_operators import (
    AdvisedOperator,
    HandGoal,
    HandOperator,
    JointOperator,
    PostureOperator,
    ScriptedOperator,
    error_to,
)
from deltaq_protocol.arrays import Array
from deltaq_verification.virtual_cell.cell import VirtualCell

PEG_M = 0.1
TURN_RAD = np.deg2rad(60.0)
LONGEST_S = 600.0

OPERATORS: dict[str, Callable[[Teleoperator, float], ScriptedOperator]] = {
    "joint": lambda teleoperator, cycle_s: JointOperator(teleoperator.robot, cycle_s),
    "decoupled": lambda teleoperator, cycle_s: HandOperator(teleoperator.robot, cycle_s, ModeName.DECOUPLED),
    "self-motion": lambda teleoperator, cycle_s: PostureOperator(teleoperator.robot, cycle_s),
    "advisor": AdvisedOperator,
    "coupled": lambda teleoperator, cycle_s: HandOperator(teleoperator.robot, cycle_s, ModeName.COUPLED),
}
"""`self-motion` and `advisor` are decoupled mode with a change of posture before each piece of work."""


class ModeFigures(BaseModel):
    """The task in one mode.

    Attributes:
        mode: the mode.
        time_s: for the whole task.
        insert_s: for putting the peg in.
        turn_s: for turning the valve.
        peg_off_mm: greatest distance of the peg from the hole's axis, in and out.
        peg_tilt_deg: greatest angle between them.
        valve_off_mm: greatest distance of the hand from the valve while it turns.
        end_mm: distance from the goal at the end, the mean of all goals.
        end_deg: the same, angle.
        limit_margin: least distance of a joint from its limit at the goals, over half its range.
        gate: verdicts by outcome.
    """

    model_config = ConfigDict(frozen=True)

    mode: str
    time_s: float
    insert_s: float
    turn_s: float
    peg_off_mm: float
    peg_tilt_deg: float
    valve_off_mm: float
    end_mm: float
    end_deg: float
    limit_margin: float
    gate: dict[str, int]


def goals(home: Array) -> list[HandGoal]:
    """The task, from the hand's home pose T_world_tool (4, 4)."""
    hole = _moved(home, (0.15, -0.2, 0.0), (0.0, 0.0, np.deg2rad(20.0)))
    inside = hole.copy()
    inside[:3, 3] += PEG_M * hole[:3, 2]
    valve = _moved(home, (-0.15, 0.15, 0.05), (np.deg2rad(15.0), 0.0, 0.0))
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
    robot: str = "gr",
    modes: Sequence[str] = tuple(OPERATORS),
    progress: Callable[[int, int], None] | None = None,
) -> list[ModeFigures]:
    """Do the task in each mode.

    Args:
        cell: the cell.
        robot: a redundant robot of it with one hand.
        modes: the modes.
        progress: called with the modes done and their number.

    Raises:
        ControllerError: there is no such mode or robot, or the task was not done in `LONGEST_S`.
    """
    unknown = [mode for mode in modes if mode not in OPERATORS]
    if unknown:
        raise ControllerError(f"no mode {unknown[0]!r} for this task; there are {', '.join(OPERATORS)}")
    figures = []
    for done, mode in enumerate(modes):
        if progress is not None:
            progress(done, len(modes))
        figures.append(_Run(cell, robot, mode).figures())
    return figures


class _Run:
    def __init__(self, cell: str | Path, robot: str, mode: str) -> None:
        self._stack = VirtualCell(cell)
        self._cycle_s = self._stack.cell.description.cycle_s
        self._robot = model_of(self._stack.cell.robots, robot)
        if len(self._robot.hands) > 1:
            raise ControllerError(
                f"the task is for one hand, robot {robot!r} has {', '.join(self._robot.hands)}"
            )
        self._name, self._mode = robot, mode
        self._teleoperator = Teleoperator(
            self._robot, self._cycle_s, modes={**MODES, ModeName.ADVISOR: self._advisor}
        )
        self._operator = OPERATORS[mode](self._teleoperator, self._cycle_s)
        self._stack.run_until_ready()
        self._stack.acquire(robot, "operator")
        self._cycles = 0

    def _advisor(self, robot: RobotModel) -> AdvisorMode:
        return AdvisorMode(robot, self._cycle_s, SynchronousAdvisor(self._stack.cell, robot.name))

    def figures(self) -> ModeFigures:
        """Do the task."""
        poses, seconds, ends, margins = {}, {}, [], []
        for goal in goals(self._robot.forward(self._robot.home)):
            way = self._to(goal)
            poses[goal.name] = [self._robot.forward(q) for q in way]
            seconds[goal.name] = len(way) * self._cycle_s
            ends.append(error_to(goal.pose, poses[goal.name][-1]).reshape(2, 3))
            margins.append(self._margin(way[-1]))
        hole, valve = (goal.pose for goal in goals(self._robot.forward(self._robot.home))[2:4])
        off = np.linalg.norm(ends, axis=2).mean(axis=0)
        peg = [_off_axis(hole, pose) for name in ("insert", "retract") for pose in poses[name]]
        turn = [float(np.linalg.norm(pose[:3, 3] - valve[:3, 3])) for pose in poses["turn"]]
        return ModeFigures(
            mode=self._mode,
            time_s=self._cycles * self._cycle_s,
            insert_s=seconds["insert"],
            turn_s=seconds["turn"],
            peg_off_mm=1000 * max(one[0] for one in peg),
            peg_tilt_deg=float(np.rad2deg(max(one[1] for one in peg))),
            valve_off_mm=1000 * max(turn),
            end_mm=1000 * float(off[0]),
            end_deg=float(np.rad2deg(off[1])),
            limit_margin=min(margins),
            gate={
                outcome: self._stack.sim.counters[outcome]
                for outcome in ("admitted", "scaled", "held", "refused")
            },
        )

    def _to(self, goal: HandGoal) -> list[Array]:
        """Measured configurations on the way to a goal."""
        way: list[Array] = []
        while True:
            self._stack.cycle()
            self._cycles += 1
            view = RobotView.from_state(self._stack.states[self._name])
            way.append(view.q)
            command = self._operator.command(view.q, goal)
            if command is None:
                return way
            self._teleoperator.command = command
            increment = self._teleoperator.increment(View(view))
            self._teleoperator.take_verdict(self._stack.ask(self._name, increment))
            if self._cycles * self._cycle_s > LONGEST_S:
                limit = self._teleoperator.limitation
                raise ControllerError(
                    f"{self._mode}: '{goal.name}' is not done after {LONGEST_S:g} s; limited by {limit}"
                )

    def _margin(self, q: Array) -> float:
        lower, upper = self._robot.lower, self._robot.upper
        return float(np.min(np.minimum(q - lower, upper - q) / (upper - lower)) * 2)


def _moved(pose: Array, offset_m: tuple[float, float, float], turn_rad: tuple[float, float, float]) -> Array:
    moved = pose.copy()
    moved[:3, 3] += offset_m
    moved[:3, :3] = pin.exp3(np.array(turn_rad)) @ pose[:3, :3]
    return moved


def _off_axis(hole: Array, pose: Array) -> tuple[float, float]:
    """Distance of a peg's tip from the hole's axis [m], and the angle between the axes [rad]."""
    axis, offset = hole[:3, 2], pose[:3, 3] - hole[:3, 3]
    across = offset - (offset @ axis) * axis
    sine = np.linalg.norm(np.cross(axis, pose[:3, 2]))
    return float(np.linalg.norm(across)), float(np.arctan2(sine, axis @ pose[:3, 2]))
