"""The courses between a robot's brake and a request: `dq(s) = (1 - s) * brake + s * request` and the brake after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltaq_cell.decisions import Decisions
from deltaq_cell.kernel.course import Course
from deltaq_cell.kernel.pieces import Tube
from deltaq_protocol.arrays import Array
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import Windows


@dataclass(frozen=True)
class Blend:
    """Courses of one robot, each by its share of the request.

    Attributes:
        robot: the robot that shall move.
        limits: of it.
        brake: (n,) next increment of its brake [rad or m].
        request: (n,) increment asked for.
        at_most: the largest share that is asked for.
    """

    robot: Tracker
    limits: Limits
    brake: Array
    request: Array
    at_most: float

    def dq(self, share: float) -> Array:
        """(n,) increment at a share [rad or m]."""
        return self.brake + share * (self.request - self.brake)

    def tube(self, share: float) -> Windows:
        """The tube of the course with a share of the request."""
        dq = self.dq(share)
        return self.robot.tube(self.robot.course(dq, self.limits.brake_cycles(dq)))

    def course(self, decisions: Decisions, before: Tube) -> Course:
        """All of them as the kernel takes them.

        Args:
            decisions: makes them.
            before: the robot's tube without the request (`Tracker.before`).
        """
        # no blend exceeds both of its ends in any joint; one cycle more for rounding
        greatest = np.maximum(np.abs(self.brake), np.abs(self.dq(self.at_most)))
        longest = self.limits.brake_cycles(greatest) + 1
        return decisions.course(
            self.robot.name, before, self.brake, self.request, self.limits.max_dv, longest
        )
