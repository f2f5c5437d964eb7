"""Retreat: the only motion that is admitted while bodies are nearer than the stop distance.

Someone may put a body into the robot's way, or a robot may start too near. Then no tube is certified, and a gate
that knew nothing else would never let go. Retreat admits slow motion on which no violated pair comes
nearer at any setpoint, and every other pair keeps the stop distance as always.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.description import GateDescription
from deltaq_cell.group import Group
from deltaq_cell.proximity import Proximity
from deltaq_protocol.messages import Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.certificate import NUMERICAL_TOLERANCE_M, Certifier
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import Branch, Piece, Windows

Array = NDArray[np.float64]
Others = Sequence[tuple[str, Piece]]

_NEARER_M = 1e-6
"""What rounding may make of a distance that does not change."""


@dataclass(frozen=True)
class _Violation:
    """Pairs of one group, by index, that are nearer than the stop distance, with their distances [m].

    `other` is the robot on the other side and a tube that it may be in, if there is one.
    """

    group: Group
    other: tuple[str, Piece] | None
    distances: dict[int, float]


class Retreat:
    """Finds the motion that leads out of a violation."""

    def __init__(self, proximity: Proximity, margins: GateDescription) -> None:
        self._proximity = proximity
        self._speed = margins.retreat_speed

    def find(
        self, robot: Tracker, others: Others, limits: Limits, brake: Array, request: Array, at_most: float
    ) -> tuple[float, list[Reason]]:
        """The scale at which a request leads out of a violation.

        Returns:
            The scale, 0 if the request brings a violated pair nearer, and the reasons.
        """
        violations = self._violations(robot, others)
        reasons = [
            Reason(
                code=ReasonCode.RETREAT,
                what=" ".join(body.name for body in item.group.pairs[index]),
                value=distance,
                bound=item.group.stop_distance_m,
            )
            for item in violations
            for index, distance in item.distances.items()
        ]
        scale = min(at_most, limits.slow_scale(brake, request, self._speed))
        dq = brake + scale * (request - brake)
        tube = robot.tube(Branch(dq, limits.brake_cycles(dq), -1))
        leads_out = scale > 0 and self._leads_out(robot.name, tube, others, violations)
        return (scale if leads_out else 0.0), reasons

    def _violations(self, robot: Tracker, others: Others) -> list[_Violation]:
        # what fails already where the robot stands, with all that the drives' lag leaves uncertain ...
        self._place(robot.name, robot.standing())
        near = []
        for other in (None, *others):
            for group in self._groups(robot.name, other):
                bound = group.stop_distance_m + NUMERICAL_TOLERANCE_M
                near.append((group, other, group.nearer(bound)[0]))
        # ... is judged by its distance at the setpoint
        self._proximity.place(robot.name, robot.q_cmd, np.zeros_like(robot.q_cmd))
        found = []
        for group, other, indices in near:
            distances = self._distances(group, other)
            found.append(_Violation(group, other, {index: distances[index] for index in indices}))
        return found

    def _groups(self, robot: str, other: tuple[str, Piece] | None) -> list[Group]:
        """Groups of the placed robot against itself and the structure, or against another, that have no room."""
        if other is None:
            groups = self._proximity.alone[robot]
        else:
            self._place(*other)
            groups = self._proximity.between[robot, other[0]]
        return self._proximity.look(groups, NUMERICAL_TOLERANCE_M).failing if groups else []

    def _distances(self, group: Group, other: tuple[str, Piece] | None) -> dict[int, float]:
        """Distances of all pairs of a group where the robot is placed [m]."""
        if other is not None:
            self._place(*other)
        self._proximity.least(group)
        return {index: pair.swept_m for index, pair in group.measured().items()}

    def _place(self, robot: str, piece: Piece) -> None:
        strip = piece.strip()
        self._proximity.place(robot, strip.middle, strip.half, strip.direction)

    def _leads_out(self, robot: str, tube: Windows, others: Others, violations: list[_Violation]) -> bool:
        with _set_aside(violations):
            certificate = Certifier(self._proximity).certify(robot, tube, others)
        if not certificate.holds:
            return False
        for point in tube.points[tube.first + 1 :]:
            self._proximity.place(robot, point, np.zeros_like(point))
            if any(self._nearer(violation) for violation in violations):
                return False
        return True

    def _nearer(self, violation: _Violation) -> bool:
        distances = self._distances(violation.group, violation.other)
        return any(distances[index] < before - _NEARER_M for index, before in violation.distances.items())


@contextmanager
def _set_aside(violations: list[_Violation]) -> Iterator[None]:
    """Leave the violated pairs out of their groups for a while."""
    for item in violations:
        for index in item.distances:
            item.group.leave_out(index)
    try:
        yield
    finally:
        for item in violations:
            for index in item.distances:
                item.group.take_in(index)
