"""Clocks of Robot Servers are read by questions, of which a busy HLI may leave some unanswered."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from told import told_state, told_status

from deltaq_controllers.robot_clocks import ClockReading
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.messages import RobotState, Status


class BusyCell:
    """Leaves the first questions unanswered, and answers the others when it is let."""

    robots = ("fr", "gr")
    description = SimpleNamespace(cycle_s=0.012)

    def __init__(self, unanswered: int, heard: tuple[str, ...] = ()) -> None:
        self.unanswered, self.heard, self.asked = unanswered, heard, 0
        self.answers = asyncio.Event()
        self.answers.set()

    async def status(self) -> Status:
        self.asked += 1
        await self.answers.wait()
        if self.asked <= self.unanswered:
            raise ServiceUnreachableError("no answer within 1 s")
        return told_status(**dict.fromkeys(self.heard, (7, 0.0)))

    def state(self, robot: str) -> RobotState | None:
        return told_state(7, 50.0, robot) if robot in self.heard else None


def reading_of(cell: Any) -> ClockReading:
    return ClockReading(cell)


async def test_an_answer_that_comes_too_late_costs_one_reading_of_the_clocks() -> None:
    cell = BusyCell(unanswered=4, heard=("fr", "gr"))
    reading = reading_of(cell)
    await reading.read_first()
    assert cell.asked == 5
    assert reading.clocks.on_clock_of("fr", "gr", 50.0) == pytest.approx(50.0)


async def test_an_hli_that_answers_nothing_is_gone() -> None:
    with pytest.raises(ServiceUnreachableError):
        await reading_of(BusyCell(unanswered=5)).read_first()


async def test_a_cycle_waits_for_no_answer_and_asks_nothing_more_before_it_has_come() -> None:
    cell = BusyCell(unanswered=0, heard=("fr",))
    cell.answers.clear()
    reading = reading_of(cell)
    for _ in range(5):
        reading.go_on()
        await asyncio.sleep(0)
    assert (cell.asked, reading.clocks.knows("fr")) == (1, False)
    cell.answers.set()
    while not reading.clocks.knows("fr"):
        await asyncio.sleep(0)


async def test_clocks_are_read_again_after_a_while_and_an_answer_that_is_missing_ends_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr("deltaq_controllers.robot_clocks.time", SimpleNamespace(monotonic=lambda: now.s))
    cell = BusyCell(unanswered=1, heard=("fr",))
    reading = reading_of(cell)

    async def asked_after(pause_s: float) -> int:
        now.s += pause_s
        reading.go_on()
        for _ in range(5):
            await asyncio.sleep(0)
        return cell.asked

    assert await asked_after(0.0) == 1
    assert await asked_after(0.01) == 1
    assert await asked_after(0.2) == 2, "no clock is known yet"
    assert await asked_after(0.2) == 2
    assert await asked_after(2.0) == 3
    cell.heard = ("fr", "gr")
    assert await asked_after(0.2) == 4, "another robot is heard"
