"""The shell around the teleoperator, on a cell without a wire."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np
import pytest
from driving import CYCLE_S
from first_cycles import Leased, Operator, QuietCell, Waits

from deltaq_controllers.modes.motion import OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.statistics import ControlStatistics
from deltaq_controllers.teleoperation import DriveLog, SignalLog, Signals, teleoperate
from deltaq_deploy.command.drive_display import summary
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.reasons import ReasonCode


class Restless(Operator):
    """Says once that it is over, and then wishes on, as keys do that are pressed after q."""

    def read(self, time_s: float) -> OperatorCommand | None:
        command = super().read(time_s)
        if command is None:
            self.commands.append((OperatorCommand({"a1": 0.2}), lambda _: False))
        return command


async def drive(
    cell: QuietCell, teleoperator: Teleoperator, operator: OperatorInput, signals: SignalLog | None = None
) -> list[np.ndarray]:
    places: list[np.ndarray] = []
    statistics, enough = ControlStatistics(), asyncio.Event()
    async with asyncio.timeout(60):
        await teleoperate(cell, teleoperator, operator, statistics, places.append, enough, signals)
    return places


async def test_an_end_that_is_told_while_the_robot_moves_is_remembered_until_it_rests() -> None:
    cell = QuietCell("lab", Waits())
    teleoperator = Teleoperator(cell.models["gr"], CYCLE_S)
    places = await drive(
        cell, teleoperator, Restless([(OperatorCommand({"a1": 0.2}), lambda cycles: cycles >= 50)])
    )
    assert abs(places[49] - places[48])[3] > 0.5 * 0.2 * CYCLE_S, "it moved when the end was told"
    assert len(places) < 80
    assert teleoperator.is_at_rest


@pytest.mark.parametrize(
    ("error", "code", "remedy"),
    [
        (RefusedError(ReasonCode.LEASE_NOT_HELD, "the lease of gr was lost"), "lease_not_held", "too busy"),
        (RefusedError(ReasonCode.STOPPED, "gr is held", "`deltaq reset`"), "stopped", "`deltaq reset`"),
        (ServiceUnreachableError("no answer"), "unreachable", "`deltaq status`"),
        (DeltaqError("it does not get on"), None, ""),
    ],
)
def test_a_drive_that_did_not_end_as_wished_says_why_and_what_to_do(
    error: DeltaqError, code: str | None, remedy: str
) -> None:
    cell = QuietCell("lab", Waits())
    log = DriveLog(Teleoperator(cell.models["gr"], CYCLE_S), CYCLE_S)
    told = summary("gr", log, ControlStatistics(), SignalLog(), error)["error"]
    assert told["code"] == code
    assert told["message"] == str(error)
    assert remedy in told["hint"]
    assert summary("gr", log, ControlStatistics(), SignalLog(), None)["error"] is None


def for_cycles(count: int, command: OperatorCommand) -> tuple[OperatorCommand, Callable[[int], bool]]:
    return command, lambda cycles: cycles >= count


async def test_an_output_that_cannot_be_switched_is_told_and_the_drive_goes_on() -> None:
    cell, signals = QuietCell("lab", Waits()), SignalLog()
    cell.refused_outputs = {"tool_changer"}
    teleoperator = Teleoperator(cell.models["gr"], CYCLE_S)
    moves = OperatorCommand({"a1": 0.2}, outputs={"tool_changer": True})
    places = await drive(
        cell, teleoperator, Operator([for_cycles(40, moves), for_cycles(5, OperatorCommand())]), signals
    )
    assert abs(places[39] - places[38])[3] > 0.5 * 0.2 * CYCLE_S
    assert cell.switched == []
    assert signals.failed[0].error == "not_ready: gr does not switch tool_changer"
    told = summary("gr", DriveLog(teleoperator, CYCLE_S), ControlStatistics(), signals, None)["outputs"]
    assert told[0] == {"output": "tool_changer", "on": True, "error": signals.failed[0].error}


async def test_outputs_are_switched_once_each_in_their_order_while_the_robot_moves() -> None:
    cell, signals = QuietCell("lab", Waits()), SignalLog()
    close, open_ = {"gripper": True}, {"gripper": False}
    operator = Operator(
        [
            for_cycles(20, OperatorCommand({"a1": 0.2}, outputs=close)),
            for_cycles(1, OperatorCommand({"a1": 0.2}, outputs=open_)),
            for_cycles(1, OperatorCommand(outputs=close)),
        ]
    )
    await drive(cell, Teleoperator(cell.models["gr"], CYCLE_S), operator, signals)
    assert cell.switched == [close, open_, close]
    assert [(each.output, each.is_on) for each in signals.switched] == [
        ("gripper", True),
        ("gripper", False),
        ("gripper", True),
    ]
    assert signals.failed == []
    assert signals.status == "gripper on"


async def test_a_drive_that_breaks_off_switches_nothing_any_more() -> None:
    leased = Leased("gr", np.zeros(9), QuietCell("lab", Waits()))

    async def broken_off() -> None:
        async with Signals(leased, ("gripper",), SignalLog()) as switches:
            switches.ask({"gripper": True})
            raise RefusedError(ReasonCode.STOPPED, "gr is held")

    with pytest.raises(RefusedError):
        await broken_off()
    assert leased.cell.switched == []
