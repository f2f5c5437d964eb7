"""First cycles of a robot that is led: by the lines to the console's driver process, or by another robot's motion."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from typing import TYPE_CHECKING, Any, Self

import pinocchio as pin

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera import FOLLOWS
from deltaq_controllers.live import ControlStatistics
from deltaq_controllers.operated.__main__ import drive_by_lines
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.operator_input.master import LedInput, Master, looking_at
from deltaq_controllers.teleoperation import teleoperate, teleoperator_for
from deltaq_protocol.driving import HAND_AXES, DriverMessage, DrivingMode, OperatorCommand

if TYPE_CHECKING:
    from first_cycles import Leased, QuietCell

CYCLES = 20
"""Cycles of each wish; then as many again to come to rest."""
CREEP_RAD = 1e-4
"""Way of a master's first joint in each cycle."""


class Lines:
    """Requests to a driver process, one after the other, each followed by some of its robot's cycles."""

    def __init__(self, cell: QuietCell, master: str | None) -> None:
        self._cell, self._master = cell, master
        self.reader = asyncio.StreamReader()
        self.answers: dict[str, dict[str, Any]] = {}
        self.report: dict[str, Any] = {}

    def say(self, told: DriverMessage) -> None:
        """What the process says."""
        line = told.model_dump(mode="json")
        if line["type"] == "answer":
            self.answers[line["id"]] = line
        elif line["type"] == "report":
            self.report = line

    def send(self, kind: str, **fields: Any) -> None:
        self.reader.feed_data(json.dumps({"type": kind, **fields}).encode() + b"\n")

    async def ask(self, kind: str, **fields: Any) -> None:
        """Send a request, and wait until it is done."""
        number = str(len(self.answers))
        self.send(kind, id=number, **fields)
        while number not in self.answers:
            await asyncio.sleep(0)
        assert self.answers[number]["done"], self.answers[number]["text"]

    async def wish(self, rates: dict[str, float] | None = None, **fields: Any) -> None:
        """Wish for some cycles, and then for nothing until the robot rests."""
        for wished in ({"rates": rates or {}, **fields}, {}):
            for _ in range(CYCLES):
                self.send("command", command=wished)
                leased = self._cell.leased
                assert leased is not None
                seen = leased.cycle
                if self._master is not None:
                    self._cell.places[self._master] = self._cell.places[self._master].copy()
                    self._cell.places[self._master][0] += CREEP_RAD
                while leased.cycle == seen:
                    await asyncio.sleep(0)

    async def change(self, **settings: str) -> None:
        """Choose mode, axes or grip."""
        await self.ask("command", command=settings)

    async def go(self, mode: str) -> None:
        """Wish to go along the first way that a mode offers, until the robot is on it."""
        while self.report["mode"] != mode or not (self.report["search"] or {"driven": 0.0})["driven"]:
            await self.wish(option=1)


@asynccontextmanager
async def driven(cell: QuietCell, robot: str, master: str | None) -> AsyncIterator[Lines]:
    """The driver process of a robot, within this one."""
    lines = Lines(cell, master)
    driving = asyncio.ensure_future(drive_by_lines(cell, robot, lines.reader, lines.say))
    try:
        yield lines
    finally:
        lines.reader.feed_eof()
        await driving


async def by_lines(cell: QuietCell, robot: str, master: str | None = None) -> None:
    """Everything that the console may ask for of a leased robot: each mode for the first time while it is held."""
    model = cell.models[robot]
    has_camera = model.description.camera is not None
    if has_camera:  # as a start of the cell does
        subprocess.run([sys.executable, "-m", "deltaq_controllers.camera", FOLLOWS], check=True)
    hands = model.hands if len(model.hands) > 1 else ("",)
    async with driven(cell, robot, master) as lines:
        await lines.ask("take", client="operator")
        is_redundant = model.n > 6 * len(hands)
        if is_redundant:  # from home, where there are options with a way to them
            await lines.change(mode="advisor")
            await lines.go("advisor")
        await lines.change(mode="pose")
        await lines.ask("reach", hand=hands[-1], **beside(model, cell.leased))
        await lines.go("pose")
        if has_camera:
            await lines.change(mode="follow")
            await lines.wish()
        for mode in ("joint", "decoupled", *(["self-motion"] if is_redundant else []), "coupled"):
            for frame in ("world", "tool"):
                await lines.change(mode=mode, frame=frame)
                if mode in ("joint", "self-motion"):
                    await lines.wish({model.joint_names[0]: 0.05})
                    continue
                for hand in (*hands, "") if len(hands) > 1 else hands:
                    prefix = f"{hand}." if hand else ""
                    await lines.wish({f"{prefix}x": 0.05, f"{prefix}rz": 0.1})
        if len(hands) > 1:
            await lines.change(mode="coupled", grip="object")
            await lines.wish({"z": 0.05, "rz": 0.1})
        if master is not None:
            await lines.ask("choose_master", master=master, scale=0.5)
            before = model.forward(cell.leased.q)[:3, 3] if cell.leased is not None else None
            await lines.wish(led="")
            assert cell.leased is not None
            assert abs(model.forward(cell.leased.q)[:3, 3] - before).max() > 1e-3, "the master leads"
        await lines.ask("release")


def beside(model: RobotModel, leased: Leased | None) -> dict[str, Any]:
    """A pose of the last hand that takes a little motion of its arm."""
    assert leased is not None
    q = leased.q.copy()
    q[-1] += 0.1 if q[-1] < 0.0 else -0.1
    T = model.forward(q, model.hands[-1])
    turn = pin.Quaternion(T[:3, :3])
    return {"position_m": T[:3, 3].tolist(), "quaternion_wxyz": (turn.w, turn.x, turn.y, turn.z)}


class Coupled(OperatorInput):
    """A button that is pressed in one mode of hands, and held while another one takes over."""

    status = "a button"

    def __init__(self) -> None:
        self._left = [
            mode for mode in (DrivingMode.DECOUPLED, DrivingMode.COUPLED) for _ in range(5 * CYCLES)
        ]

    def read(self, time_s: float) -> OperatorCommand | None:
        led = "" if len(self._left) < 9 * CYCLES else None
        return OperatorCommand(mode=self._left.pop(0), led=led) if self._left else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""


async def by_master(cell: QuietCell, robot: str, master: str) -> None:
    """`deltaq drive --master`: another robot's tool leads a hand."""
    led: list[dict[str, float]] = []
    with ExitStack() as stack:
        teleoperator = teleoperator_for(cell, robot, stack)
        teleoperator.make_modes()
        look = looking_at(cell, master, robot)
        operator = LedInput(Coupled(), Master(teleoperator, cell.models[master], look, 0.5))

        def watch(_q: Any) -> None:
            led.append(dict(teleoperator.command.rates))
            cell.places[master] = cell.places[master].copy()
            cell.places[master][0] += CREEP_RAD

        await teleoperate(cell, teleoperator, operator, ControlStatistics(), watch, asyncio.Event())
    assert any(set(rates) == set(HAND_AXES) for rates in led), "the master leads"
