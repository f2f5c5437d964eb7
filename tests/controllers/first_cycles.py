"""Drive one controller by its own shell on a cell that admits everything, and tell what its cycles had to wait for.

Run as a program, `python first_cycles.py CASE`, it prints a JSON object: the functions that were compiled or loaded
from numba's cache, and the modules that were imported, while the controller held its lease (`late`) and before
(`early`).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Mapping
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from traceback import extract_stack
from typing import Any, Self

import numpy as np
import published_arms
from led_cycles import by_lines, by_master
from numba.core import event

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.session import AdvisorSession
from deltaq_controllers.camera.controllers import NAMES, camera_controller_named
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.camera_follower import MoveToStart
from deltaq_controllers.criteria import BY_NAME
from deltaq_controllers.interface import Controller, View
from deltaq_controllers.leader.attacking import AttackingLeader
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.live import ControlStatistics, drive
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.task import Task
from deltaq_controllers.teleoperation import DriveLog, SignalLog, teleoperate, teleoperator_for
from deltaq_deploy.command.drive_display import Display
from deltaq_protocol.client import Cell
from deltaq_protocol.driving import HAND_AXES, TELEOPERATION, DrivingMode, Frame, Grip, OperatorCommand
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import (
    IoReply,
    LeaseStatus,
    Outcome,
    Phase,
    RobotState,
    RobotStatus,
    Status,
    ToolPose,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode

POSE = ToolPose(position=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
HANDS_MODES = (DrivingMode.DECOUPLED, DrivingMode.COUPLED)
CYCLES = 20
"""Cycles of each command: enough to speed up, and to settle into another mode."""


class Waits(event.Listener):
    """What Python had to wait for: functions that were compiled or loaded, modules that were imported."""

    def __init__(self) -> None:
        self.functions: list[str] = []
        self._modules = set(sys.modules)
        # both a compilation and a load from the cache take this lock
        event.register("numba:compiler_lock", self)

    def on_start(self, happened: event.Event) -> None:
        """Note the line of ours that needs the function."""
        own = [frame for frame in extract_stack() if "deltaq_" in frame.filename]
        self.functions.append(f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else happened.kind)

    def on_end(self, happened: event.Event) -> None:
        """It has begun before."""

    def told(self) -> dict[str, list[str]]:
        """What has happened since the last question."""
        modules = sorted(set(sys.modules) - self._modules)
        told = {"functions": self.functions, "modules": modules}
        self.functions, self._modules = [], set(sys.modules)
        return told


def loaded(name: str) -> CellModel:
    """A shipped cell, or `arms`, the one of the guide, whose robots nobody wrote an inverse for."""
    return published_arms.cell() if name == "arms" else CellModel.load(name)


@dataclass
class Leased:
    """One robot of the quiet cell: it does as it is told, in cycles that come as fast as they are answered."""

    robot: str
    q: np.ndarray
    cell: QuietCell
    cycle: int = 0

    def state(self) -> RobotState:
        q = tuple(self.q.tolist())
        time_s = self.cycle * self.cell.description.cycle_s
        return RobotState(
            robot=self.robot,
            cycle=self.cycle,
            ipoc=0,
            time_s=time_s,
            q=q,
            q_cmd=q,
            tool=POSE,
            phase=Phase.ENGAGED,
        )

    async def io(self, outputs: Mapping[str, bool] | None = None) -> IoReply:
        refused = set(outputs or {}) & self.cell.refused_outputs
        if refused:
            raise RefusedError(ReasonCode.NOT_READY, f"{self.robot} does not switch {', '.join(refused)}")
        self.cell.switched += [dict(outputs)] if outputs else []
        return IoReply(robot=self.robot, outputs=dict(outputs or {}))

    async def states(self) -> AsyncIterator[RobotState]:
        while True:
            self.cycle += 1
            yield self.state()
            await asyncio.sleep(0)

    async def move(self, dq: Iterable[float]) -> Verdict:
        moved = tuple(dq)
        self.q = self.q + np.array(moved)
        return Verdict(
            robot=self.robot, cycle=self.cycle, seq=self.cycle, outcome=Outcome.ADMITTED, scale=1.0, dq=moved
        )


class QuietCell(Cell):
    """A cell without a wire; while a lease is held, what Python waits for is `late`."""

    def __init__(self, name: str, waits: Waits) -> None:
        cell = loaded(name)
        self._description = cell.description_message()
        self.robots = self._description.robots
        self.models = cell.robots
        self.waits = waits
        self.early: dict[str, list[str]] = {}
        self.late: dict[str, list[str]] = {}
        self.leased: Leased | None = None
        self.switched: list[dict[str, bool]] = []
        self.refused_outputs: set[str] = set()
        self.places = {name: np.array(model.home) for name, model in self.models.items()}

    def state(self, robot: str) -> RobotState:
        if self.leased is not None and robot == self.leased.robot:
            return self.leased.state()
        still = Leased(robot, self.places[robot], self)
        still.cycle = self.leased.cycle if self.leased is not None else 0
        return still.state()

    async def round_trip_s(self) -> float:
        return 0.0

    async def status(self) -> Status:
        robots = {
            name: RobotStatus(
                phase=Phase.ENGAGED,
                reason=None,
                cycle=self.state(name).cycle,
                state_age_s=0.0,
                q=self.state(name).q,
                lease=LeaseStatus(),
                counters={},
            )
            for name in self.robots
        }
        return Status(cell=self.description.cell, robots=robots, gate={}, gate_age_s=None, hli={})

    @asynccontextmanager
    async def lease(
        self, robot: str, client: str | None = None, take: bool = False, playout: bool = False
    ) -> AsyncIterator[Any]:
        self.leased = Leased(robot, self.places[robot], self)
        self.early = self.waits.told()
        try:
            yield self.leased
        finally:
            self.late = self.waits.told()


@dataclass
class Operator(OperatorInput):
    """Wishes one after the other, each for a number of cycles or until it is so."""

    commands: list[tuple[OperatorCommand, Callable[[int], bool]]]
    _since: int = field(default=0, init=False)

    def read(self, time_s: float) -> OperatorCommand | None:
        while self.commands:
            command, is_over = self.commands[0]
            if not is_over(self._since):
                self._since += 1
                return command
            self.commands.pop(0)
            self._since = 0
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""


def enough(cycles: int) -> bool:
    return cycles >= CYCLES


def everything(teleoperator: Teleoperator, modes: Iterable[DrivingMode]) -> Operator:
    """Every mode with every axis that it drives, in both frames, and the way to an option."""
    commands: list[tuple[OperatorCommand, Callable[[int], bool]]] = []
    for mode in modes:
        commands.append((OperatorCommand(mode=mode), enough))
        if mode is DrivingMode.ADVISOR:
            advisor = teleoperator.mode_named(mode)
            assert isinstance(advisor, AdvisorMode)
            commands.append((OperatorCommand(option=1), lambda _, advisor=advisor: advisor.done > 0.1))
        if len(teleoperator.hand_names) > 1 and mode is not DrivingMode.JOINT:
            commands.append((OperatorCommand(grip=Grip.OBJECT), enough))
            commands.append((OperatorCommand({"rz": 0.2} if mode in HANDS_MODES else {}), enough))
            commands.append((OperatorCommand(grip=Grip.FREE), enough))
        for number, axis in enumerate(teleoperator.axes(mode)):
            rate = 0.05 if axis.rpartition(".")[2] in HAND_AXES else 0.2
            commands.append((OperatorCommand({axis: rate}, frame=list(Frame)[number % 2]), enough))
    return Operator(commands)


async def by_hand(
    cell: QuietCell, robot: str, modes: Iterable[DrivingMode], weights: Mapping[str, float] | None = None
) -> None:
    with ExitStack() as stack:
        teleoperator = teleoperator_for(cell, robot, stack, task=Task(weights=weights))
        teleoperator.make_modes()
        operator = everything(teleoperator, modes)
        log, signals = DriveLog(teleoperator, cell.description.cycle_s), SignalLog()
        display = Display(teleoperator, operator, signals)

        def watch(q: np.ndarray) -> None:
            log.add(q)
            display.show()

        await teleoperate(cell, teleoperator, operator, ControlStatistics(), watch, asyncio.Event(), signals)


async def by_controller(
    cell: QuietCell, robot: str, made: Callable[[], Controller], watch: Callable[[View], None] | None = None
) -> None:
    controller, task = made(), asyncio.current_task()
    assert task is not None

    def look(view: View) -> None:
        if watch is not None:
            watch(view)
        if view.own.cycle > 5 * CYCLES:
            task.cancel()

    with contextlib.suppress(asyncio.CancelledError):
        await drive(cell, robot, controller, ControlStatistics(), look)


async def by_camera(cell: QuietCell, name: str) -> None:
    """A camera controller, from far off its focus to where it evades the leader."""
    scene = Scene(CellModel.load("lab"), "fr", "gr")
    camera = camera_controller_named(name, scene, 1.25)
    limits = IncrementLimits.of(scene.robot, scene.cycle_s)

    tools = np.random.default_rng(1).uniform(scene.leader.lower, scene.leader.upper, (500, scene.leader.n))
    lens = scene.robot.camera_pose(scene.robot.home)[:3, 3]
    near = min(tools, key=lambda q: float(np.linalg.norm(scene.leader.forward(q)[:3, 3] - lens)))

    is_seen = False

    def watch(view: View) -> None:
        nonlocal is_seen
        if view.own.cycle == 2 * CYCLES:
            cell.places["gr"] = near
        if (leader := view.others.get("gr")) is not None:  # once its clock is known
            is_seen = True
            camera.errors(view.own.q, leader.q)
            camera.clearance(view.own.q, leader.q)

    move_to_start = MoveToStart(camera, limits, None, (1.25, 0.4), 0.6)
    await by_controller(cell, "fr", lambda: move_to_start, watch)
    assert is_seen


def leader() -> Controller:
    return ScriptedLeader(CellModel.load("lab").robots["gr"], 0.012)


def attacker() -> Controller:
    robots = CellModel.load("lab").robots
    return AttackingLeader(robots["gr"], robots["fr"], 0.012, target="all")


async def counsel(cell: QuietCell, robot: str) -> None:
    """What the advisor's process does, question by question."""
    advisor = AdvisorSession(loaded(cell.description.cell), robot)
    home = cell.models[robot].home
    async with cell.lease(robot):
        advisor.ask(home, {}, lambda _: True)
        advisor.seek(home[None], 1, {}, lambda _: True)


# from home, where there are options with a way to them
MODES = (DrivingMode.ADVISOR, *(mode for mode in TELEOPERATION if mode is not DrivingMode.ADVISOR))
ALL = dict.fromkeys(BY_NAME, 1.0)
FREE = (DrivingMode.JOINT, DrivingMode.DECOUPLED, DrivingMode.COUPLED)
CASES: dict[str, tuple[str, Callable[[QuietCell], Coroutine[Any, Any, None]]]] = {
    "modes-gr": ("lab", partial(by_hand, robot="gr", modes=MODES)),
    "criteria-gr": ("lab", partial(by_hand, robot="gr", modes=(DrivingMode.COUPLED,), weights=ALL)),
    "modes-fr": ("lab", partial(by_hand, robot="fr", modes=FREE)),
    "modes-ur": ("arms", partial(by_hand, robot="ur", modes=FREE)),
    "modes-panda": ("arms", partial(by_hand, robot="panda", modes=MODES)),
    "criteria-panda": ("arms", partial(by_hand, robot="panda", modes=(DrivingMode.COUPLED,), weights=ALL)),
    "modes-dawm": ("dawm", partial(by_hand, robot="dawm", modes=MODES)),
    **{name: ("lab", partial(by_camera, name=name)) for name in NAMES},
    "operated-fr": ("lab", partial(by_lines, robot="fr")),
    "operated-gr": ("lab", partial(by_lines, robot="gr", master="fr")),
    "operated-dawm": ("dawm", partial(by_lines, robot="dawm")),
    "master-gr": ("lab", partial(by_master, robot="gr", master="fr")),
    "leader": ("lab", partial(by_controller, robot="gr", made=leader)),
    "attacker": ("lab", partial(by_controller, robot="gr", made=attacker)),
    "counsel-gr": ("lab", partial(counsel, robot="gr")),
    "counsel-dawm": ("dawm", partial(counsel, robot="dawm")),
    "counsel-panda": ("arms", partial(counsel, robot="panda")),
}


def main(case: str) -> None:
    name, run = CASES[case]
    cell = QuietCell(name, Waits())
    asyncio.run(run(cell))
    print(json.dumps({"early": cell.early, "late": cell.late}))


if __name__ == "__main__":
    main(sys.argv[1])
