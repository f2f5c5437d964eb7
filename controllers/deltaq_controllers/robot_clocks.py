"""The clocks of a cell's Robot Servers, which may be on as many hosts: one clock for each robot's path.

All are read with the same exchanges. What is wrong with these is wrong with all clocks alike, so that between two
robots it cancels out: how much older one's state is than the other's is known better than the age of either.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from deltaq_controllers.path_clock import PathClock, robot_clock_s
from deltaq_protocol.messages import RobotState, Status


class RobotClocks:
    """Offsets of the robots' clocks, and conversion of one clock's stamps to another.

    Args:
        robots: their names.
        cycle_s: cycle of all of them [s].
    """

    def __init__(self, robots: Iterable[str], cycle_s: float) -> None:
        self._clocks = {name: PathClock() for name in robots}
        self._cycle_s = cycle_s
        self._moved: dict[tuple[str, str], tuple[float, float]] = {}

    def take(
        self, asked_s: float, status: Status, answered_s: float, newest: Mapping[str, RobotState]
    ) -> None:
        """Add an exchange.

        Args:
            asked_s: when the HLI was asked, on this clock [s].
            status: its answer.
            answered_s: when that had come, on this clock [s].
            newest: of each robot that was heard, a state that had come when it was asked.
        """
        for name, state in newest.items():
            stamp_s = robot_clock_s(status, state, self._cycle_s)
            if stamp_s is not None:
                self._clocks[name].take(asked_s, stamp_s, answered_s)

    def knows(self, robot: str) -> bool:
        """Whether the clock of a robot was read."""
        return self._clocks[robot].known

    def on_clock_of(self, robot: str, other: str, stamp_s: float) -> float | None:
        """A stamp of `other` [s] on the clock of `robot` [s]; None while one of them is not known.

        The newest stamp does not change when clocks are read again, so that a state seen twice is not taken for two.
        """
        own, its = self._clocks[robot], self._clocks[other]
        if not (own.known and its.known):
            return None
        before = self._moved.get((robot, other))
        if before is None or before[0] != stamp_s:
            before = self._moved[robot, other] = (stamp_s, stamp_s - its.offset_s + own.offset_s)
        return before[1]

    def age_s(self, robot: str, stamp_s: float, now_s: float) -> float | None:
        """How old is what a robot's server stamped [s], on this clock now [s]; None while it is not known."""
        clock = self._clocks[robot]
        return clock.age_s(stamp_s, now_s) if clock.known else None

    def summary(self, now_s: float) -> dict[str, dict[str, float | None]]:
        """Offset of each robot's clock to this one and the bound of its error now [s], as a JSON object."""
        return {name: clock.summary(now_s) for name, clock in self._clocks.items()}
