"""Drive a robot of a running cell by hand: the shell around the teleoperator."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import Any, Self

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.process import AdvisorProcess
from deltaq_controllers.answers import Answers, lease
from deltaq_controllers.criteria.formulas import RobotData
from deltaq_controllers.criteria.table import check_known
from deltaq_controllers.live import (
    ControlStatistics,
    cell_model,
    check_tools,
    control_loop,
    model_of,
    robot_models,
    where_others_are,
)
from deltaq_controllers.modes.advisor import AdvisorMode, tracker_of
from deltaq_controllers.modes.hand_modes import CoupledMode, weighed
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.practice import practise
from deltaq_controllers.modes.teleoperator import MODES, ModeTable, Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_controllers.task import NO_TASK, Task
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.driving import DrivingMode, Frame, Grip, OperatorCommand
from deltaq_protocol.errors import DeltaqError, RefusedError
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import IoReply, Phase
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode

# The teleoperator of a robot of a running cell, with all modes that the robot can be driven in.


def teleoperator_for(
    running: Cell,
    robot: str,
    stack: ExitStack,
    mode: DrivingMode = DrivingMode.JOINT,
    frame: Frame = Frame.WORLD,
    task: Task = NO_TASK,
    jerk_time_s: float = 0.0,
    trade_off: tuple[str, str] | None = None,
    hands_may_leave: bool | None = False,
) -> Teleoperator:
    """A teleoperator as `deltaq drive` uses it; no mode but the first is made yet.

    Args:
        running: connection to the cell.
        robot: name of the robot.
        stack: ends background work of the modes.
        mode: to begin with.
        frame: axes in which hands are moved.
        task: of `coupled` and `advisor`.
        jerk_time_s: time in which a joint's acceleration builds up to its limit; 0 sets no limit to the jerk [s].
        trade_off: names of two criteria; the advisor's options are on their Pareto front; None: they are minima.
        hands_may_leave: whether hands may leave their poses on the path to an option of the advisor, and return;
            None: only for robots that are not redundant.

    Raises:
        ControllerError: the robot is unknown, or cannot be driven in that mode.
        CriterionError: an unknown criterion.
        TaskError: the cell or the robot does not have what the task names.
    """
    for name in trade_off or ():
        check_known(name)
    description = running.description
    model = model_of(robot_models(description), robot)

    def advisor_mode(robot: RobotModel) -> AdvisorMode:
        others = where_others_are(running, robot.name)
        tracker = tracker_of(robot, hands_may_leave in (True, None), task)
        advisor = AdvisorProcess(description, tracker, others)
        mode = AdvisorMode(robot, description.cycle_s, stack.enter_context(advisor))
        mode.trade_off = trade_off
        mode.hands_may_leave = not len(tracker.base) if hands_may_leave is None else hands_may_leave
        return mode

    cell = task.seen(cell_model(description))
    task.check_hands(model)
    criteria = None if task.weights is None else (weighed(RobotData(cell, robot, task=task), task.weights),)
    coupled = partial(CoupledMode, criteria=criteria, task=task)
    modes: ModeTable = {**MODES, DrivingMode.ADVISOR: advisor_mode, DrivingMode.COUPLED: coupled}
    around = RobotSurroundings(cell, robot)
    return Teleoperator(model, description.cycle_s, mode, frame, modes, around, jerk_time_s)


# Digital outputs of a robot as an operator switches them while it is driven, and its inputs: the shell around `io`.


LOOK_S = 0.5
"""Time after which outputs and inputs are read again [s]."""


@dataclass(frozen=True)
class Switched:
    """The result of switching an output.

    Attributes:
        output: its name.
        is_on: how it was to be.
        error: why it was not; empty if it was.
    """

    output: str
    is_on: bool
    error: str = ""

    def summary(self) -> dict[str, Any]:
        """As a JSON object."""
        return {"output": self.output, "on": self.is_on, "error": self.error or None}


@dataclass
class SignalLog:
    """The newest digital signals of a robot.

    Attributes:
        outputs, inputs: as last read, by name.
        switched: the outputs switched so far, in order.
    """

    outputs: dict[str, bool] = field(default_factory=dict)
    inputs: dict[str, bool] = field(default_factory=dict)
    switched: list[Switched] = field(default_factory=list)

    @property
    def status(self) -> str:
        """Outputs and inputs as one line of text."""
        told = {**self.outputs, **self.inputs}
        return ", ".join(f"{name} {'on' if is_on else 'off'}" for name, is_on in told.items())


class Signals:
    """Switches outputs one after the other beside the control loop, and reads them again from time to time.

    A context manager, used while the lease is held; outputs requested before its end are still switched.

    Args:
        leased: the robot.
        names: of its outputs and inputs; without any nothing is read.
        log: gets the signals.
    """

    def __init__(self, leased: LeasedRobot, names: tuple[str, ...], log: SignalLog) -> None:
        self._leased, self._has_any, self._log = leased, bool(names), log
        self._asked: dict[str, bool] = {}
        self._due: asyncio.Queue[Mapping[str, bool] | None] = asyncio.Queue()
        self._task: asyncio.Task[None] | None = None

    def ask(self, outputs: Mapping[str, bool]) -> None:
        """Have outputs switched; a command that lasts for many cycles counts once."""
        new = {name: is_on for name, is_on in outputs.items() if self._asked.get(name) is not is_on}
        if new:
            self._asked |= new
            self._due.put_nowait(new)

    async def __aenter__(self) -> Self:
        if self._has_any:
            self._due.put_nowait({})
            self._task = asyncio.create_task(self._serve())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Switch the outputs that are still due, unless the drive was interrupted."""
        if self._task is None:
            return
        if error is None:
            self._due.put_nowait(None)
            await self._task
        else:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _serve(self) -> None:
        while (outputs := await self._next()) is not None:
            await self._switch(outputs)

    async def _next(self) -> Mapping[str, bool] | None:
        with suppress(TimeoutError):
            async with asyncio.timeout(LOOK_S):
                return await self._due.get()
        return {}

    async def _switch(self, outputs: Mapping[str, bool]) -> None:
        """Set outputs, or read all of them; an error ends no drive, and the same can be asked for again."""
        told = ""
        try:
            reply: IoReply = await self._leased.io(outputs)
        except DeltaqError as error:
            told = str(error)
            for name in outputs:
                self._asked.pop(name, None)
        else:
            self._log.outputs, self._log.inputs = dict(reply.outputs), dict(reply.inputs)
        self._log.switched += [Switched(name, is_on, told) for name, is_on in outputs.items()]


@dataclass
class Leg:
    """A stretch of driving in one mode and with one grip.

    Attributes:
        mode: the mode.
        grip: whether the hands held an object.
        cycles: its length.
        limited: cycles in which the operator was limited, by kind and object.
        moved: per hand the displacement from beginning to end [m, rad], and its largest deviation.
        chosen: requested options of the advisor, in order, each with whether the robot arrived.
        parted: greatest deviation of the hands from their grasp [m, rad].
    """

    mode: DrivingMode
    grip: Grip = Grip.FREE
    cycles: int = 0
    limited: Counter[str] = field(default_factory=Counter)
    moved: Array = field(default_factory=lambda: np.zeros((0, 2)))
    farthest: Array = field(default_factory=lambda: np.zeros((0, 2)))
    chosen: list[tuple[int, bool]] = field(default_factory=list)
    parted: tuple[float, float] = (0.0, 0.0)


class DriveLog:
    """Record of a drive, as measured.

    Args:
        teleoperator: the robot's.
        cycle_s: its cycle [s].
    """

    def __init__(self, teleoperator: Teleoperator, cycle_s: float) -> None:
        self._teleoperator = teleoperator
        self._cycle_s = cycle_s
        self._hands = Hands(teleoperator.robot)
        self._start = (self._hands.rotations, self._hands.positions)
        self.legs: list[Leg] = []

    def add(self, q: Array) -> None:
        """Record a cycle, with the robot measured at `q` (n,)."""
        self._hands.update(q)
        mode, grip = self._teleoperator.mode, self._teleoperator.grip
        if not self.legs or (self.legs[-1].mode, self.legs[-1].grip) != (mode, grip):
            self.legs.append(Leg(mode, grip))
            self._start = (self._hands.rotations.copy(), self._hands.positions.copy())
        leg = self.legs[-1]
        leg.cycles += 1
        self._note_choice(leg)
        limitation = self._teleoperator.limitation
        if limitation is not None:
            leg.limited[f"{limitation.limit.value}: {limitation.what}"] += 1
        leg.moved = np.linalg.norm(self._hands.error(*self._start).reshape(-1, 2, 3), axis=2)
        leg.farthest = np.maximum(leg.farthest, leg.moved) if leg.cycles > 1 else leg.moved
        if self._teleoperator.held is not None:
            apart_m, twisted_rad = self._teleoperator.held.parted(
                self._hands.rotations, self._hands.positions
            )
            leg.parted = max(leg.parted[0], apart_m), max(leg.parted[1], twisted_rad)

    def _note_choice(self, leg: Leg) -> None:
        option = self._teleoperator.command.option
        if option is None or leg.mode is not DrivingMode.ADVISOR:
            return
        choice = option, self._teleoperator.arrived_at == option
        if leg.chosen and leg.chosen[-1][0] == option:
            leg.chosen[-1] = choice
        else:
            leg.chosen.append(choice)

    @property
    def missed(self) -> list[int]:
        """Options that were wanted last in their leg and not reached."""
        return [leg.chosen[-1][0] for leg in self.legs if leg.chosen and not leg.chosen[-1][1]]

    def summary(self) -> list[dict[str, Any]]:
        """Each leg as a JSON object, in mm and degrees."""
        return [self._summary(leg) for leg in self.legs]

    def _summary(self, leg: Leg) -> dict[str, Any]:
        hands = {
            name: {
                "moved_mm": 1000 * float(moved[0]),
                "turned_deg": float(np.rad2deg(moved[1])),
                "farthest_mm": 1000 * float(farthest[0]),
                "farthest_deg": float(np.rad2deg(farthest[1])),
            }
            for name, moved, farthest in zip(
                self._teleoperator.hand_names, leg.moved, leg.farthest, strict=True
            )
        }
        seconds = leg.cycles * self._cycle_s
        limited_s = {what: cycles * self._cycle_s for what, cycles in leg.limited.items()}
        parted_mm, twisted_deg = 1000 * leg.parted[0], float(np.rad2deg(leg.parted[1]))
        held = {"parted_mm": parted_mm, "twisted_deg": twisted_deg}
        return {
            "mode": leg.mode.value,
            "grip": leg.grip.value,
            "object": held if leg.grip is Grip.OBJECT else None,
            "seconds": seconds,
            "limited_s": limited_s,
            "hands": hands,
            "options": [{"option": option, "reached": reached} for option, reached in leg.chosen],
        }


async def teleoperate(
    cell: Cell,
    teleoperator: Teleoperator,
    operator: OperatorInput,
    statistics: ControlStatistics,
    watch: Callable[[Array], None],
    enough: asyncio.Event,
    signals: SignalLog | None = None,
) -> None:
    """Drive until the operator's input ends or `enough` is set, then come to rest and release the robot.

    Every mode made so far runs once on the robot's model before the lease is taken (`practise`).

    Args:
        cell: connection to the cell.
        teleoperator: of the robot.
        operator: source of the commands.
        statistics: counts the verdicts.
        watch: called once a cycle with the measured configuration (n,).
        enough: set it to end the drive early.
        signals: switches outputs, and keeps the newest inputs and outputs.

    Raises:
        RefusedError: the lease was not granted or lost, or the robot is held.
        ServiceUnreachableError: the HLI is gone.
        ToolChangedError: a robot has another tool now.
    """
    coupled = cell.description.coupled
    robot, described = teleoperator.robot.name, teleoperator.robot.description
    is_over = False
    await asyncio.to_thread(practise, teleoperator)
    if enough.is_set():
        return
    with control_loop():
        async with (
            await lease(cell, robot) as leased,
            Signals(leased, described.outputs + described.inputs, signals or SignalLog()) as switches,
        ):
            answers = Answers(cell, leased)
            async for state in leased.states():
                if state.phase is Phase.HELD:
                    raise _held(robot, state.reason)
                check_tools(cell, coupled)
                command = None if is_over or enough.is_set() else operator.read(state.time_s)
                is_over = (
                    command is None
                )  # for good: keys pressed while the robot comes to rest do not start it again
                teleoperator.command = OperatorCommand() if command is None else command
                switches.ask(teleoperator.command.outputs)
                for cycle in await answers.due(state):
                    increment = teleoperator.increment(answers.view(state))
                    if is_over and teleoperator.is_at_rest:
                        return
                    await answers.send(state, cycle, increment)
                for verdict in answers.verdicts():
                    statistics.add(verdict)
                    teleoperator.take_verdict(verdict)
                watch(np.array(state.q))


def _held(robot: str, reason: ReasonCode | None) -> RefusedError:
    why = f": {EXPLANATIONS[reason]}" if reason is not None else ""
    return RefusedError(ReasonCode.STOPPED, f"{robot} is held{why}", f"`deltaq reset --robot {robot}`")
