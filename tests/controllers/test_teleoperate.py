"""The shell around the teleoperator, on a cell without a wire."""

import asyncio
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from driving import CYCLE_S
from first_cycles import Leased, Operator, QuietCell, Waits

from deltaq_controllers.live import ControlStatistics, ErrorStatistics
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import AskedViewDistance, OperatorInput, stepped
from deltaq_controllers.teleoperation import DriveLog, SignalLog, Signals, teleoperate
from deltaq_deploy.command.drive_display import summary
from deltaq_protocol.driving import OperatorCommand
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Outcome, Reason, RobotState, Verdict, ViewReply, ViewWish
from deltaq_protocol.pad_layout import VIEW_RANGE_M, VIEW_STEP_M
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
    async with asyncio.timeout(300):
        await teleoperate(cell, teleoperator, operator, statistics, places.append, enough, signals)
    return places


async def test_an_end_requested_in_motion_waits_for_rest() -> None:
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
def test_a_drive_that_ends_early_gives_reason_and_remedy(
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


async def test_a_failed_output_is_reported_and_the_drive_continues() -> None:
    cell, signals = QuietCell("lab", Waits()), SignalLog()
    cell.refused_outputs = {"tool_changer"}
    teleoperator = Teleoperator(cell.models["gr"], CYCLE_S)
    moves = OperatorCommand({"a1": 0.2}, outputs={"tool_changer": True})
    places = await drive(
        cell, teleoperator, Operator([for_cycles(40, moves), for_cycles(5, OperatorCommand())]), signals
    )
    assert abs(places[39] - places[38])[3] > 0.5 * 0.2 * CYCLE_S
    assert cell.switched == []
    assert signals.switched[0].error == "not_ready: gr does not switch tool_changer"
    told = summary("gr", DriveLog(teleoperator, CYCLE_S), ControlStatistics(), signals, None)["outputs"]
    assert told[0] == {"output": "tool_changer", "on": True, "error": signals.switched[0].error}


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
    assert not any(each.error for each in signals.switched)
    assert signals.status == "gripper on"


async def test_an_aborted_drive_switches_no_further_output() -> None:
    leased = Leased("gr", np.zeros(9), QuietCell("lab", Waits()))

    async def broken_off() -> None:
        async with Signals(leased, ("gripper",), SignalLog()) as switches:
            switches.ask({"gripper": True})
            raise RefusedError(ReasonCode.STOPPED, "gr is held")

    with pytest.raises(RefusedError):
        await broken_off()
    assert leased.cell.switched == []


# The view distance in steps: what is asked of whoever follows the robot that is driven.


class WatchedCell(QuietCell):
    """Takes requests for another view, as the HLI does."""

    def __init__(self, name: str = "lab", holder: str | None = "follower") -> None:
        super().__init__(name, Waits())
        self.asked: list[tuple[str, float | None]] = []
        self.holder, self.refuses = holder, False
        self.wish: ViewWish | None = None

    def state(self, robot: str) -> RobotState:
        return super().state(robot).model_copy(update={"view": self.wish if robot == "fr" else None})

    async def view(self, robot: str, distance_m: float | None = None, *_: Any, **__: Any) -> ViewReply:
        await asyncio.sleep(0)
        if self.refuses:
            raise RefusedError(ReasonCode.NOT_PERMITTED, "a controller's token is needed")
        self.asked.append((robot, distance_m))
        self.wish = ViewWish(distance_m=distance_m)
        return ViewReply(robot=robot, view=self.wish, holder=self.holder)


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


def test_a_step_stays_within_the_range_of_the_pad() -> None:
    least_m, most_m = VIEW_RANGE_M
    assert stepped(1.234, VIEW_STEP_M) == pytest.approx(1.33)
    assert stepped(most_m - 0.01, VIEW_STEP_M) == most_m
    assert stepped(least_m, -VIEW_STEP_M) == least_m


async def test_the_first_step_starts_from_the_measured_distance_and_the_next_from_the_requested_one() -> None:
    cell = WatchedCell()
    view = AskedViewDistance(cell, "gr")
    lens = cell.models["fr"].camera_pose(cell.places["fr"])[:3, 3]
    seen_m = float(np.linalg.norm(np.array(cell.state("gr").tool.position) - lens))
    view.change(-VIEW_STEP_M)
    await settled()
    assert cell.asked == [("fr", pytest.approx(seen_m - VIEW_STEP_M, abs=0.006))]
    first_m = cell.wish.distance_m if cell.wish else None
    view.change(VIEW_STEP_M)
    view.change(VIEW_STEP_M)
    await settled()
    assert first_m is not None
    assert cell.asked[-1] == ("fr", pytest.approx(first_m + 2 * VIEW_STEP_M))
    assert view.status == f"view {cell.asked[-1][1]:.2f} m"


async def test_a_missing_follower_a_refusal_and_a_missing_camera_are_reported() -> None:
    cell = WatchedCell(holder=None)
    view = AskedViewDistance(cell, "gr")
    view.change(VIEW_STEP_M)
    await settled()
    assert view.status.endswith("m, no follower runs on fr")
    cell.refuses = True
    view.change(VIEW_STEP_M)
    await settled()
    assert "token" in view.status
    alone = AskedViewDistance(cell, "fr")
    alone.change(VIEW_STEP_M)
    assert alone.status == "no camera watches fr"


def test_figures_count_from_the_end_of_the_start_up_and_are_sizes() -> None:
    errors = ErrorStatistics()
    errors.add(9.0, settled=False)
    assert errors.figures() == {"rms": None, "max": None, "final": 9.0}
    for error in (3.0, -4.0):
        errors.add(error, settled=True)
    assert errors.figures() == {"rms": pytest.approx(math.sqrt(12.5)), "max": 4.0, "final": 4.0}
    assert errors.figures(unit=2.0)["max"] == 2.0


def test_verdicts_reasons_and_missing_verdicts_are_counted() -> None:
    statistics = ControlStatistics()
    bound = Reason(code=ReasonCode.CLEARANCE)
    statistics.add(Verdict(robot="fr", cycle=1, seq=1, outcome=Outcome.ADMITTED))
    statistics.add(Verdict(robot="fr", cycle=2, seq=2, outcome=Outcome.SCALED, reasons=(bound,)))
    statistics.add(None)
    statistics.add(Verdict(robot="fr", cycle=4, seq=4, outcome=Outcome.UNKNOWN))
    summary = statistics.summary()
    assert summary == {
        "cycles": 4,
        "unanswered": 2,
        "gate": {"admitted": 1, "scaled": 1, "held": 0, "refused": 0, "carried": 0},
        "reasons": {"clearance": 1},
    }
    json.dumps(summary)
