"""Drive a robot of a running cell by hand: the shell around the teleoperator."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deltaq_controllers.answers import Answers, lease
from deltaq_controllers.live import control_loop
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.motion import Grip, ModeName, OperatorCommand
from deltaq_controllers.modes.practice import practise
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.signals import SignalLog, Signals
from deltaq_controllers.statistics import ControlStatistics
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode


@dataclass
class Leg:
    """A stretch of driving in one mode and with one grip.

    Attributes:
        mode: the mode.
        grip: whether the hands held an object.
        cycles: its length.
        limited: cycles in which something limited the operator, by kind and what.
        moved: per hand the displacement from beginning to end [m, rad], and its largest deviation.
        chosen: options of the advisor that were wanted, in their order, each with whether the robot got there.
        parted: by how much the hands that held an object were off from one another at most [m, rad].
    """

    mode: ModeName
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
        if option is None or leg.mode is not ModeName.ADVISOR:
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
        """Each leg as a JSON object, for people: mm and degrees."""
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
        operator: where the commands come from.
        statistics: counts the verdicts.
        watch: called once a cycle with the measured configuration (n,).
        enough: set it to end the drive early.
        signals: takes what is switched, and how outputs and inputs are.

    Raises:
        RefusedError: the lease was not granted or lost, or the robot is held.
        ServiceUnreachableError: the HLI is gone.
    """
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
