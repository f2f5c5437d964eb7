"""Retreat: the only motion that is admitted while bodies are nearer than the stop distance.

Someone may put a body into the robot's way, or a robot may start too near. Then no tube is certified, and without an
exception the robot could never move again. Retreat admits slow motion that is certified like any other, except that a
violated pair has to keep the distance that it had when its violation began (`Violations`) instead of the stop
distance. That distance is known only of robots that stood still then: no robot retreats into one that moves.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.description import GateDescription
from deltaq_cell.group import Group
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import KeptDistance
from deltaq_protocol.messages import Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.certificate import NUMERICAL_TOLERANCE_M
from deltaq_services.sim.compiled_certificate import CompiledCertifier
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import Branch, Piece

BodyPair = frozenset[str]
"""Names of two bodies."""

ALLOWANCE_M = 5e-6
"""How much nearer a pair may come in all while its violation lasts: only as much as rounding needs."""

_MEASURED_M = 2e-6
"""Largest difference of the same distance when it is measured again."""


class Violations:
    """The distances that violated pairs have to keep [m].

    A violation has a cause outside the gate: no admission leads into one. The distance at its beginning, measured while
    the robots concerned stood still, is kept until it has ended. A weaker rule would not do: a gate that compared with
    the cycle before, with a tolerance for rounding, would let a robot creep into contact, a micrometre at a time.
    """

    def __init__(self) -> None:
        self._kept: dict[BodyPair, float] = {}

    def kept_m(self, pair: BodyPair) -> float | None:
        """The distance that a violated pair has to keep; None for other pairs."""
        return self._kept.get(pair)

    def stands(self, pair: BodyPair, distance_m: float, stop_distance_m: float) -> None:
        """Note a pair that was measured nearer than its stop distance while its robots were at rest.

        Args:
            pair: names of the bodies.
            distance_m: at the setpoints.
            stop_distance_m: the distance that the pair must keep otherwise.
        """
        keeps = min(distance_m - ALLOWANCE_M, stop_distance_m)
        before = self._kept.get(pair)
        # no admission can have brought it nearer than it had to keep: another cause did
        if before is None or distance_m < before - _MEASURED_M:
            self._kept[pair] = keeps

    def only(self, robot: str, violated: Collection[BodyPair]) -> None:
        """Keep only these violations of a robot; all its others have ended."""
        ended = [pair for pair in self._kept if _concerns(pair, robot) and pair not in violated]
        for pair in ended:
            del self._kept[pair]

    def snapshot(self) -> tuple[KeptDistance, ...]:
        """Snapshot for `restore`."""
        return tuple(
            KeptDistance(pair=(one, other), distance_m=distance)
            for (one, other), distance in sorted((sorted(pair), item) for pair, item in self._kept.items())
        )

    def restore(self, memory: Iterable[KeptDistance]) -> None:
        """Restore a snapshot of another gate."""
        self._kept = {frozenset(item.pair): item.distance_m for item in memory}


def _concerns(pair: BodyPair, robot: str) -> bool:
    return any(name.startswith(f"{robot}/") for name in pair)


@dataclass(frozen=True)
class _Near:
    """A pair, by its index in a group, that is not shown to have its room; `other` is the robot on the other side."""

    group: Group
    index: int
    other: Tracker | None

    @property
    def names(self) -> tuple[str, str]:
        first, second = self.group.pairs[self.index]
        return first.name, second.name

    @property
    def pair(self) -> BodyPair:
        return frozenset(self.names)


class Retreat:
    """Finds the motion that leads out of a violation.

    Args:
        proximity: the bodies.
        margins: of the gate.
        violations: distances that pairs have to keep; updated by every check.
    """

    def __init__(
        self, proximity: CompiledProximity, margins: GateDescription, violations: Violations
    ) -> None:
        self._proximity = proximity
        self._speed = margins.retreat_speed
        self._violations = violations

    def find(
        self,
        robot: Tracker,
        others: Sequence[Tracker],
        limits: Limits,
        brake: Array,
        request: Array,
        at_most: float,
    ) -> tuple[float, list[Reason]]:
        """The scale at which a request leads out of violations.

        Args:
            robot: the robot that shall move.
            others: the other robots.
            limits: of the robot.
            brake: (n,) next increment of the brake [rad or m].
            request: (n,) increment asked for.
            at_most: the largest scale that other limits leave.

        Returns:
            The scale, 0 if the request is not certified to keep each pair's distance, and a reason for every
            violation.
        """
        violated, reasons = self._violated(robot, others)
        scale = min(at_most, limits.slow_scale(brake, request, self._speed))
        dq = brake + scale * (request - brake)
        branch = robot.course(dq, limits.brake_cycles(dq))
        leads_out = scale > 0 and self._leads_out(robot, branch, others, violated)
        return (scale if leads_out else 0.0), reasons

    def _violated(self, robot: Tracker, others: Sequence[Tracker]) -> tuple[list[_Near], list[Reason]]:
        """Pairs whose violation has been measured, and the reasons for them."""
        near = self._near(robot, others)
        self._violations.only(robot.name, {item.pair for item in near})
        violated, reasons = [], []
        for item in near:
            distance = self._distance_m(robot, item)
            if robot.stands_still() and (item.other is None or item.other.stands_still()):
                self._violations.stands(item.pair, distance, item.group.stop_distance_m)
            if self._violations.kept_m(item.pair) is None:
                continue  # certified as always, so not before the robots are at rest
            violated.append(item)
            bound = item.group.stop_distance_m
            reasons.append(
                Reason(code=ReasonCode.RETREAT, what=" ".join(item.names), value=distance, bound=bound)
            )
        return violated, reasons

    def _near(self, robot: Tracker, others: Sequence[Tracker]) -> list[_Near]:
        """Pairs that are not shown to have their room where the robot stands, each once."""
        self._place(robot.name, robot.standing())
        found = {(item.group, item.index): item for item in self._without_room(robot.name, None)}
        for other in others:
            for tube in other.tubes():
                self._place(other.name, tube)
                found |= {(item.group, item.index): item for item in self._without_room(robot.name, other)}
        return list(found.values())

    def _without_room(self, robot: str, other: Tracker | None) -> Iterator[_Near]:
        between = None if other is None else self._proximity.between[robot, other.name]
        groups = self._proximity.alone[robot] if between is None else between
        failing = self._proximity.look(groups, NUMERICAL_TOLERANCE_M).failing if groups else []
        for group in self._proximity.measured(failing):
            for index in group.nearer(group.stop_distance_m + NUMERICAL_TOLERANCE_M):
                yield _Near(group, index, other)

    def _distance_m(self, robot: Tracker, near: _Near) -> float:
        """Distance of a pair at the setpoints [m]."""
        for tracker in (robot, near.other):
            if tracker is not None:
                self._proximity.place(tracker.name, tracker.q_cmd, np.zeros_like(tracker.q_cmd))
        return self._proximity.least(self._proximity.pair(near.group, near.index))

    def _place(self, robot: str, piece: Piece) -> None:
        span = piece.span()
        self._proximity.place(robot, span.middle, span.half, span.offsets, span.deviation)

    def _leads_out(
        self, robot: Tracker, branch: Branch, others: Sequence[Tracker], violated: Sequence[_Near]
    ) -> bool:
        with _set_aside(violated):
            tubes = [(other.name, tube) for other in others for tube in other.tubes()]
            as_always = CompiledCertifier(self._proximity).certify(robot.name, robot.tube(branch), tubes)
        return as_always.holds and self._keep(robot, branch, violated)

    def _keep(self, robot: Tracker, branch: Branch, violated: Sequence[_Near]) -> bool:
        """Whether each violated pair keeps its required distance.

        That distance was measured at setpoints, so measured joints do not count here either: drives that
        stand a little off their setpoints would be a separate violation, for ever.
        """
        certifier = CompiledCertifier(self._proximity)
        tube = robot.tube_of_setpoints(branch)
        for other in dict.fromkeys(item.other for item in violated):
            pairs = [self._keeping(item) for item in violated if item.other is other]
            if other is None:
                kept = certifier.alone(robot.name, tube, pairs).holds
            else:
                kept = all(
                    certifier.between(robot.name, tube, other.name, theirs, pairs).holds
                    for theirs in other.tubes_of_setpoints()
                )
            if not kept:
                return False
        return True

    def _keeping(self, near: _Near) -> Group:
        kept = self._violations.kept_m(near.pair)
        assert kept is not None  # only such pairs are violated
        pair = self._proximity.pair(near.group, near.index)
        pair.stop_distance_m = kept - NUMERICAL_TOLERANCE_M  # which the certificate adds again
        return pair


@contextmanager
def _set_aside(violated: Sequence[_Near]) -> Iterator[None]:
    """Leave the violated pairs out of their groups for a while."""
    for item in violated:
        item.group.leave_out(item.index)
    try:
        yield
    finally:
        for item in violated:
            item.group.take_in(item.index)
