"""Summary of a robot for a client's welcome. Loads no kinematics."""

from __future__ import annotations

from deltaq_cell.description import RobotDescription
from deltaq_protocol import messages


def robot_summary(description: RobotDescription, cycle_s: float) -> messages.RobotSummary:
    """Names, units, limits and home of one robot in joint order; `max_increment` is the largest step of one cycle."""
    return messages.RobotSummary(
        joints=description.joint_names,
        units=description.units,
        lower=tuple(description.lower.tolist()),
        upper=tuple(description.upper.tolist()),
        max_velocity=tuple(description.max_velocity.tolist()),
        max_acceleration=tuple(description.max_acceleration.tolist()),
        max_increment=tuple((description.max_velocity * cycle_s).tolist()),
        home=tuple(description.home.tolist()),
    )
