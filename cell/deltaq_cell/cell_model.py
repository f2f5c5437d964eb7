"""A whole cell, modelled: its description, its robots and its structure, built once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pinocchio as pin

from deltaq_cell.description import CellDescription
from deltaq_cell.hull import Corners
from deltaq_cell.identity import cell_identity
from deltaq_cell.load import load_with_text
from deltaq_cell.robot import RobotModel
from deltaq_cell.structure import structure_geometry
from deltaq_cell.summary import robot_summary
from deltaq_cell.told_kinematics import told_kinematics
from deltaq_protocol import messages
from deltaq_protocol.codec import MAX_ZENOH_MESSAGE_BYTES, pack, to_line
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.identity import CellIdentity

MOST_TOLD_BYTES = MAX_ZENOH_MESSAGE_BYTES - 64 * 1024
"""Longest description that can be sent to clients, as msgpack and as a line of JSON."""


class LongDescriptionError(DeltaqError):
    """A cell's description is too long for its clients."""


def robots_told(
    description: CellDescription, urdf: Mapping[str, str], hulls: Mapping[str, Mapping[str, Corners]]
) -> dict[str, RobotModel]:
    """Models of a cell's robots from their description, received or recorded; no file of the user's is needed.

    Args:
        description: of the cell.
        urdf: URDF text by robot.
        hulls: by robot and body; a mesh without one is searched for among the installed packages.

    Raises:
        RobotModelError: a mesh that came without its hull is not found.
    """
    return {
        name: RobotModel(robot, name, urdf=urdf[name], hulls=hulls.get(name))
        for name, robot in description.robots.items()
    }


@dataclass(frozen=True)
class CellModel:
    """A cell's description with the models of its robots and its structure.

    Attributes:
        description: as its YAML gives it.
        robots: name to model, in the order of the description.
        structure: bodies that stand still, in world coordinates, named `structure/...`.
        yaml: the YAML text.
    """

    description: CellDescription
    robots: dict[str, RobotModel]
    structure: tuple[pin.GeometryObject, ...]
    yaml: str

    @classmethod
    def load(cls, name_or_path: str | Path) -> CellModel:
        """Build the model of a cell, by name (`lab`) or path.

        Raises:
            CellError: the cell is not found or its file has errors.
            RobotModelError: a robot's model is not found or does not fit.
        """
        description, text = load_with_text(name_or_path)
        robots = {name: RobotModel(robot, name) for name, robot in description.robots.items()}
        return cls.of(description, robots, text)

    @classmethod
    def of(cls, description: CellDescription, robots: dict[str, RobotModel], yaml: str = "") -> CellModel:
        """Put a cell together from its description and the models of its robots."""
        return cls(description, robots, tuple(structure_geometry(description)), yaml)

    @cached_property
    def identity(self) -> CellIdentity:
        """Its name and hash, by which two processes see whether they have read one cell."""
        urdf = {name: robot.urdf for name, robot in self.robots.items()}
        return cell_identity(
            self.description, urdf, {name: robot.hulls for name, robot in self.robots.items()}
        )

    def description_message(self) -> messages.Description:
        """Everything a client needs to model the cell, as the HLI answers it.

        Visual meshes are left out: they are megabytes and decide nothing; the gate sees the hulls.

        Raises:
            LongDescriptionError: it is longer than a message can be.
        """
        cell = self.description
        message = messages.Description(
            cell=cell.cell,
            cycle_s=cell.cycle_s,
            robots={name: robot_summary(robot, cell.cycle_s) for name, robot in cell.robots.items()},
            yaml=self.yaml,
            urdf={name: robot.urdf for name, robot in self.robots.items()},
            hulls={name: robot.hulls for name, robot in self.robots.items()},
            kinematics={name: told_kinematics(robot) for name, robot in self.robots.items()},
            identity=str(self.identity),
        )
        length = max(len(pack(message)), len(to_line(message)))
        if length > MOST_TOLD_BYTES:
            parts = {f"the URDF of {name}": len(text) for name, text in message.urdf.items()} | {
                "the YAML": len(message.yaml)
            }
            longest = max(parts, key=lambda part: parts[part])
            raise LongDescriptionError(
                f"the description of cell {cell.cell} is {length} bytes long, and clients can be told "
                f"{MOST_TOLD_BYTES}; the longest part is {longest} with {parts[longest]}"
            )
        return message
