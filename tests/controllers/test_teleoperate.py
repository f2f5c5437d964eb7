"""The shell around the teleoperator, on a cell without a wire."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from driving import CYCLE_S
from first_cycles import Operator, QuietCell, Waits

from deltaq_command.drive_summary import summary
from deltaq_controllers.modes.motion import OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.statistics import ControlStatistics
from deltaq_controllers.teleoperation import DriveLog, teleoperate
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.reasons import ReasonCode


class Restless(Operator):
    """Says once that it is over, and then wishes on, as keys do that are pressed after q."""

    def read(self, time_s: float) -> OperatorCommand | None:
        command = super().read(time_s)
        if command is None:
            self.commands.append((OperatorCommand({"a1": 0.2}), lambda _: False))
        return command


async def drive(cell: QuietCell, teleoperator: Teleoperator, operator: OperatorInput) -> list[np.ndarray]:
    places: list[np.ndarray] = []
    async with asyncio.timeout(60):
        await teleoperate(cell, teleoperator, operator, ControlStatistics(), places.append, asyncio.Event())
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
    told = summary("gr", log, ControlStatistics(), error)["error"]
    assert told["code"] == code
    assert told["message"] == str(error)
    assert remedy in told["hint"]
    assert summary("gr", log, ControlStatistics(), None)["error"] is None
