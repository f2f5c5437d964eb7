"""How another host's clock stands to this one's, and with that how old a state is where it is read.

As NTP does (RFC 5905, 8): a request and its answer enclose the moment at which the other clock was read. If both took
equally long, that moment is the middle. If not, the estimate is wrong by half of the difference, and never by more than
half of the round trip. The quickest round trip of all is believed: what makes one slow seldom makes both ways equally
slow.
"""

from __future__ import annotations

import math

from deltaq_protocol.messages import RobotState, Status


class PathClock:
    """The clock at the other end of one path.

    Attributes:
        offset_s: what that clock shows less what this one shows [s]; 0 before the first exchange.
        error_s: by how much the offset may be wrong at most [s]; infinite before the first exchange.
    """

    def __init__(self) -> None:
        self.offset_s, self.error_s = 0.0, math.inf

    def take(self, asked_s: float, stamp_s: float, answered_s: float) -> None:
        """Add an exchange.

        Args:
            asked_s: when the request went out, on this clock [s].
            stamp_s: what the other clock showed in between [s].
            answered_s: when the answer had come, on this clock [s].

        Raises:
            ValueError: the answer was there before the request, so the clock was set.
        """
        if answered_s < asked_s:
            raise ValueError(f"answered_s: {answered_s} is before the request, {asked_s}")
        error_s = (answered_s - asked_s) / 2.0
        if error_s < self.error_s:
            self.offset_s, self.error_s = stamp_s - (asked_s + answered_s) / 2.0, error_s

    def summary(self) -> dict[str, float | None]:
        """Offset and bound of its error as a JSON object; None before the first exchange."""
        known = math.isfinite(self.error_s)
        return {"offset_s": self.offset_s if known else None, "error_s": self.error_s if known else None}

    def age_s(self, stamp_s: float, now_s: float) -> float:
        """How old is what was stamped on the other clock [s], on this one now [s]."""
        return now_s - (stamp_s - self.offset_s)


def robot_clock_s(status: Status, newest: RobotState, cycle_s: float) -> float | None:
    """What the clock of a robot's server showed when the HLI answered with a status [s].

    The answer names the newest cycle and its age. Its stamp follows from that of a state that has come, by whole
    cycles: the KRC counts them evenly.

    Args:
        status: the answer.
        newest: any state of the robot.
        cycle_s: cycle of the robot [s].

    Returns:
        The time, later by what a state takes from the Robot Server to the HLI; None if the HLI knows no state.
    """
    robot = status.robots.get(newest.robot)
    if robot is None or robot.state_age_s is None:
        return None
    return newest.time_s + (robot.cycle - newest.cycle) * cycle_s + robot.state_age_s
