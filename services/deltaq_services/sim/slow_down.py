"""Speed and separation: the nearer two bodies are, the slower they may approach one another.

Within the band between the stop distance and `slow_down_distance_m` the approach speed that is allowed falls in
proportion to the room that is left, as in speed and separation monitoring. It is counted along the line between the
nearest points, from this robot's own motion; of two robots each has half. The invariants do not rest on it: it makes
motion near bodies gentle, not safe.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deltaq_cell.description import GateDescription
from deltaq_cell.proximity import ProximityEngine
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.tracker import Tracker


class SlowDown:
    """The band around all bodies of a cell.

    Args:
        proximity: of the cell.
        margins: the gate's.
        cycle_s: sample time of its robots.
    """

    def __init__(self, proximity: ProximityEngine, margins: GateDescription, cycle_s: float) -> None:
        self._proximity = proximity
        self._distance_m = margins.slow_down_distance_m
        self._fastest = margins.slow_down_speed_m_s * cycle_s
        self._cycle_s = cycle_s

    def scale(
        self, robot: Tracker, others: Sequence[Tracker], brake: Array, request: Array, at_most: float
    ) -> tuple[float, list[Reason]]:
        """Largest s <= `at_most` with which no pair in the band approaches too fast, and the reason if it is less.

        Args:
            robot: the robot that is to move, judged at the setpoint that the increment is added to.
            others: the other robots, at their present setpoints.
            brake: (n,) next increment of the brake [rad or m].
            request: (n,) increment asked for.
            at_most: the largest s that other limits leave.
        """
        if self._distance_m is None:
            return at_most, []
        self._place(robot.name, robot.ahead.q_cmd)
        # of two robots each has half of the speed
        lists = [(1.0, self._proximity.alone[robot.name])]
        for other in others:
            self._place(other.name, other.q_cmd)
            lists.append((0.5, self._proximity.between[robot.name, other.name]))
        scale, reasons = at_most, []
        near = [
            (share, approach)
            for share, groups in lists
            if groups
            for approach in self._proximity.approaches(robot.name, groups, self._distance_m)
        ]
        for share, approach in near:
            room = (approach.distance_m - approach.stop_distance_m) / (
                self._distance_m - approach.stop_distance_m
            )
            allowed = share * self._fastest * max(room, 0.0)
            before, change = approach.per_joint @ brake, approach.per_joint @ (request - brake)
            if change <= 0.0 or before + scale * change <= allowed:
                continue
            scale = max(float((allowed - before) / change), 0.0)
            reasons = [
                Reason(
                    code=ReasonCode.SLOW_DOWN,
                    what=" ".join(approach.pair),
                    value=float(before + at_most * change) / self._cycle_s,
                    bound=allowed / self._cycle_s,
                )
            ]
        return scale, reasons

    def _place(self, robot: str, q: Array) -> None:
        self._proximity.place(robot, q, np.zeros_like(q))
