"""What a client is told of a cell. Loads no kinematics, so that every service can afford it."""

from __future__ import annotations

from pathlib import Path

from deltaq_cell.description import RobotDescription
from deltaq_cell.load import cell_text, load_cell
from deltaq_cell.models import load_urdf
from deltaq_protocol import messages


def robot_summary(description: RobotDescription, cycle_s: float) -> messages.RobotSummary:
    """Names, units and limits of one robot in joint order; `max_increment` is the largest step of one cycle."""
    return messages.RobotSummary(
        joints=description.joint_names,
        units=description.units,
        lower=tuple(description.lower.tolist()),
        upper=tuple(description.upper.tolist()),
        max_velocity=tuple(description.max_velocity.tolist()),
        max_acceleration=tuple(description.max_acceleration.tolist()),
        max_increment=tuple((description.max_velocity * cycle_s).tolist()),
    )


def description_message(name_or_path: str | Path) -> messages.Description:
    """Everything a client needs to model a cell: limits, the YAML text and each robot's URDF text.

    Raises:
        CellError: the cell is not found or its file has errors.
        RobotModelError: a robot's model is not found.
    """
    cell = load_cell(name_or_path)
    return messages.Description(
        cell=cell.cell,
        cycle_s=cell.cycle_s,
        robots={name: robot_summary(robot, cell.cycle_s) for name, robot in cell.robots.items()},
        yaml=cell_text(name_or_path),
        urdf={name: load_urdf(robot.model).text for name, robot in cell.robots.items()},
    )
