"""The advisor within the control loop, for virtual time: its search takes no virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import Progress
from deltaq_controllers.advisor.session import AdvisorSession
from deltaq_protocol.arrays import Array


class SynchronousAdvisor:
    """Answers before it returns, the other robots of the cell at home.

    Args:
        cell: model of the cell.
        robot: name of the robot.
        weights: of the criteria; the advisor's own if not given.
        options: how many at most.
        effort: of the search.

    Attributes:
        tracker: of the robot.
        progress: the results so far; None before the first question.
    """

    trouble = ""
    is_busy = False

    def __init__(
        self,
        cell: CellModel,
        robot: str,
        weights: Mapping[str, float] | None = None,
        options: int = 5,
        effort: float = 1.0,
    ) -> None:
        self._counsel = AdvisorSession(cell, robot, weights, options=options, effort=effort)
        self.tracker = self._counsel.tracker
        self.progress: Progress | None = None

    def prepare(self) -> None:
        """Nothing to prepare: the model of the cell is loaded."""

    def ask(self, q: Array, trade_off: tuple[str, str] | None = None, hands_may_leave: bool = False) -> None:
        """Look for options; see `AdvisorSession.ask`."""
        self._counsel.ask(q, {}, self._take, trade_off, hands_may_leave)

    def seek(self, back: Array, rank: int) -> None:
        """Search for a path to the option of a rank; see `Counsel.seek`."""
        self._counsel.seek(back, rank, {}, self._take)

    def give_up(self) -> None:
        """Nothing is going on."""

    def _take(self, progress: Progress) -> bool:
        self.progress = progress
        return True
