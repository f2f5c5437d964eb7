"""Which robot of a cell has joints to spare."""

from __future__ import annotations

from collections.abc import Mapping

from deltaq_cell.robot import RobotModel
from deltaq_controllers.inverse.tracking import ConstraintTracker, TrackingError


def first_redundant(
    robots: Mapping[str, RobotModel], most_hands: int | None = None
) -> ConstraintTracker | None:
    """The inverse of the first redundant robot of a cell; None if there is none.

    Args:
        robots: of the cell, by name.
        most_hands: it may have; None for any number.
    """
    for robot in robots.values():
        if most_hands is not None and len(robot.hands) > most_hands:
            continue
        try:
            tracker = ConstraintTracker(robot)
        except TrackingError:
            continue
        if len(tracker.base):
            return tracker
    return None
