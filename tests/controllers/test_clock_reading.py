"""The clock of a robot's server is read by questions, of which a busy HLI may leave some unanswered."""

import pytest

from deltaq_controllers.live import read_clock
from deltaq_controllers.path_clock import PathClock
from deltaq_protocol.errors import ServiceUnreachableError


class BusyCell:
    """Leaves the first questions unanswered."""

    def __init__(self, unanswered: int) -> None:
        self.unanswered, self.asked = unanswered, 0

    async def status(self) -> None:
        self.asked += 1
        if self.asked <= self.unanswered:
            raise ServiceUnreachableError("no answer within 1 s")

    def state(self, robot: str) -> None:
        """No robot has been heard."""


async def test_an_answer_that_comes_too_late_costs_one_reading_of_the_clock() -> None:
    cell = BusyCell(unanswered=4)
    await read_clock(PathClock(), cell, "gr")  # type: ignore[arg-type] # asks for no more than this of a cell
    assert cell.asked == 5


async def test_an_hli_that_answers_nothing_is_gone() -> None:
    with pytest.raises(ServiceUnreachableError):
        await read_clock(PathClock(), BusyCell(unanswered=5), "gr")  # type: ignore[arg-type] # as above
