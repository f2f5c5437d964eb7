"""Looks at the bodies of a cell as coal alone makes them: inflated bodies, group by group, without screens or planes.

Nothing of the product runs it; tests hold the gate's kernel against it.
"""

from collections.abc import Sequence

from deltaq_cell.compiled_proximity import DistanceQuery
from deltaq_cell.group import Group
from deltaq_cell.proximity import ProximityEngine
from deltaq_protocol.arrays import Array


class ReferenceProximity(ProximityEngine):
    """All bodies of a cell, placed in boxes of joint space and looked at in groups."""

    def place(
        self, robot: str, q: Array, half: Array, offsets: Array | None = None, deviation: Array | None = None
    ) -> float:
        """Place a robot in the box around a span, as `CompiledProximity.place` does."""
        del offsets, deviation  # which only planes ask for
        return super().place(robot, q, half)

    def look(self, groups: Sequence[Group], room_m: float) -> DistanceQuery:
        """The groups whose inflated bodies have less than `room_m` beyond their stop distance; see `CompiledProximity`.

        Groups fail here that planes keep apart.
        """
        rooms = {group: self.least(group) - group.stop_distance_m for group in groups if not group.is_empty}
        if not rooms:
            return DistanceQuery([], False, None, 0.0)
        failing = [group for group, room in rooms.items() if room < room_m]
        too_near = any(
            near.distance_m < group.stop_distance_m + room_m
            for group in failing
            for near in group.measured().values()
        )
        tightest = min(rooms, key=rooms.__getitem__)
        return DistanceQuery(failing, too_near, tightest.nearest(), tightest.stop_distance_m)
