"""`deltaq_services.sim.certificate` in machine code, many times quicker and with a larger budget.

The kernel divides the same tubes in the same way, but asks each half only for those pairs that the whole left open
(`deltaq_cell.kernel.decision`). So it needs fewer pieces. It certifies nothing that the readable code would not
certify with a budget that is large enough; tests hold the one against the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.decisions import Decisions, Division
from deltaq_cell.group import Group, PairedGroups
from deltaq_cell.kernel.course import Course
from deltaq_cell.kernel.decision import Against
from deltaq_cell.kernel.pieces import Tube
from deltaq_protocol.arrays import Array
from deltaq_services.sim.certificate import (
    HALVINGS,
    NUMERICAL_TOLERANCE_M,
    ROUNDS,
    Binding,
    Certificate,
    Certifier,
    Suspects,
    largest,
)
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import Windows


@dataclass(frozen=True)
class Blend:
    """Courses between a robot's brake and a request: `dq(s) = (1 - s) * brake + s * request` and the brake after it.

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


BUDGET = 600
"""Searches between two bodies in parts of tubes that one certifier may spend; the first look at whole tubes is free."""

SHARE_BUDGET = 400
"""The same, of all smaller shares of a request together. What they miss by is a part of one cycle's motion, where a
request that is refused for want of a search may lose all of it."""

TRIAL_BUDGET = 40
"""The part of it that one trial of suspects may spend on one other tube: a failing trial would otherwise spend all,
and leave nothing for smaller shares.
"""


class CompiledCertifier(Certifier):
    """Certifies tubes, all within one budget of searches.

    Args:
        proximity: the bodies.
        budget: how many pairs may be searched in parts of tubes.
        tells: whether the pair with the least room is asked for.
    """

    def __init__(self, proximity: CompiledProximity, budget: int = BUDGET, tells: bool = True) -> None:
        super().__init__(proximity, budget)
        self._kernel = proximity
        self._decisions = proximity.decisions
        self._tells = tells
        self._at_most = budget

    def certify(self, robot: str, tube: Windows, others: Sequence[tuple[str, Windows]]) -> Certificate:
        """Certify one robot's tube against the structure, itself and the tubes of others, in one call."""
        if self._decisions.asks_a_depth(NUMERICAL_TOLERANCE_M):
            return super().certify(robot, tube, others)
        whole = self._decisions.certify(
            robot,
            self._tube(robot, tube),
            self._against(robot, others),
            NUMERICAL_TOLERANCE_M,
            self._left,
            self._tells,
        )
        self._left = whole.left
        binding = None if whole.tightest is None else Binding(whole.tightest, whole.stop_distance_m)
        suspects = None if whole.failing is None else Suspects(whole.other, whole.failing)
        return Certificate(whole.holds, binding, suspects)

    def largest(
        self, blend: Blend, others: Sequence[tuple[str, Windows]], refused: float, first: Certificate
    ) -> float:
        """The largest certified share that the search of `deltaq_services.sim.certificate` finds, in one call.

        Args:
            blend: the courses.
            others: names of other robots with each tube that they may be in.
            refused: a share whose certificate does not hold.
            first: that certificate.
        """
        robot = blend.robot.name
        if self._decisions.asks_a_depth(NUMERICAL_TOLERANCE_M):
            return largest(
                lambda share: self.certify(robot, blend.tube(share), others),
                lambda share, suspects: self.judge(robot, blend.tube(share), others, suspects),
                refused,
                first,
            )
        assert first.failing is not None  # it does not hold
        assert isinstance(first.failing.groups, PairedGroups)  # as this class tells it
        share, self._left = self._decisions.largest_share(
            blend.course(self._decisions, self._tube(robot, blend.robot.before())),
            refused,
            self._against(robot, others),
            (first.failing.other, first.failing.groups.numbers),
            NUMERICAL_TOLERANCE_M,
            self._left,
            TRIAL_BUDGET,
            HALVINGS,
            ROUNDS,
        )
        return share

    def judge(
        self,
        robot: str,
        tube: Windows,
        others: Sequence[tuple[str, Windows]],
        suspects: Sequence[Suspects],
    ) -> bool:
        """Whether suspects are shown to keep apart, each by no more than a trial's searches in two tubes."""
        before, self._at_most = self._at_most, TRIAL_BUDGET
        holds = super().judge(robot, tube, others, suspects)
        self._at_most = before
        return holds

    def alone(self, robot: str, tube: Windows, groups: Sequence[Group]) -> Certificate:
        """Certify groups of one robot against the structure or itself."""
        if self._kernel.keep_a_depth(groups, NUMERICAL_TOLERANCE_M):
            return super().alone(robot, tube, groups)
        return self._certify(self._tube(robot, tube), None, None, groups)

    def between(
        self, robot: str, tube: Windows, other: str, other_tube: Windows, groups: Sequence[Group]
    ) -> Certificate:
        """Certify groups of one robot against another, whose tube is `other_tube`."""
        if self._kernel.keep_a_depth(groups, NUMERICAL_TOLERANCE_M):
            return super().between(robot, tube, other, other_tube, groups)
        return self._certify(self._tube(robot, tube), other, self._tube(other, other_tube), groups)

    def _against(self, robot: str, others: Sequence[tuple[str, Windows]]) -> Against:
        return self._decisions.against(robot, [(name, self._tube(name, tube)) for name, tube in others])

    def _tube(self, robot: str, tube: Windows) -> Tube:
        drives = tube.drives
        return self._kernel.whole_tube(
            robot, tube.points, drives.lag, tube.first, tube.last, drives.tolerance, drives.spread
        )

    def _certify(
        self, mine: Tube, other: str | None, theirs: Tube | None, groups: Sequence[Group]
    ) -> Certificate:
        given = min(self._left, self._at_most)
        division: Division = self._kernel.certify(
            mine, theirs, groups, NUMERICAL_TOLERANCE_M, given, self._tells
        )
        self._left -= given - division.left
        nearest, stop_distance_m = division.tightest, division.stop_distance_m
        binding = None if nearest is None else Binding(nearest, stop_distance_m)
        return Certificate(
            division.holds, binding, None if division.holds else Suspects(other, division.failing)
        )
