"""A controller that sees the other robots late: what an experiment adds to the latency of a loop."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from deltaq_controllers.interface import Controller, RobotView, View
from deltaq_protocol.arrays import Array


class HeldBack:
    """Holds back what a controller sees of the other robots, stamps and all; of its own robot it sees the newest.

    Args:
        controller: makes the increments.
        cycles: by how many views the others are held back.
    """

    def __init__(self, controller: Controller, cycles: int) -> None:
        self._controller = controller
        self._seen: deque[Mapping[str, RobotView]] = deque(maxlen=cycles + 1)

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        self._seen.append(view.others)
        return self._controller.increment(View(view.own, self._seen[0]))
