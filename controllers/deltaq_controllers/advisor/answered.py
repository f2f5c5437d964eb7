"""An advisor whose answer is known already."""

from __future__ import annotations

from deltaq_controllers.advisor.advisor import Progress
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array


class Answered:
    """Gives one prepared answer to every question.

    Args:
        tracker: of the robot.
        progress: the answer.

    Attributes:
        tracker, progress: as given.
        trouble: why there is no path from the robot's configuration.
    """

    is_busy = False

    def __init__(self, tracker: ConstraintTracker, progress: Progress) -> None:
        self.tracker = tracker
        self.progress: Progress | None = progress
        self.trouble = ""

    def prepare(self) -> None:
        """Nothing to prepare."""

    def ask(
        self, _q: Array, _trade_off: tuple[str, str] | None = None, _hands_may_leave: bool = False
    ) -> None:
        """The answer is known already."""

    def seek(self, _back: Array, _rank: int) -> None:
        """No path begins where the robot is."""
        self.trouble = f"{self.tracker.robot.name} has been moved meanwhile; advise again"

    def give_up(self) -> None:
        """Nothing to cancel."""
