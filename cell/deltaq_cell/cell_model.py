"""A whole cell, modelled: its description, its robots and its structure, built once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pinocchio as pin

from deltaq_cell.description import CellDescription
from deltaq_cell.load import cell_text, load_cell
from deltaq_cell.robot import RobotModel
from deltaq_cell.structure import structure_geometry
from deltaq_cell.summary import robot_summary
from deltaq_protocol import messages


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
        description = load_cell(name_or_path)
        robots = {name: RobotModel(robot, name) for name, robot in description.robots.items()}
        return cls.of(description, robots, cell_text(name_or_path))

    @classmethod
    def of(cls, description: CellDescription, robots: dict[str, RobotModel], yaml: str = "") -> CellModel:
        """Put a cell together from its description and the models of its robots."""
        return cls(description, robots, tuple(structure_geometry(description)), yaml)

    def description_message(self) -> messages.Description:
        """Everything a client needs to model the cell, as the HLI answers it."""
        cell = self.description
        return messages.Description(
            cell=cell.cell,
            cycle_s=cell.cycle_s,
            robots={name: robot_summary(robot, cell.cycle_s) for name, robot in cell.robots.items()},
            yaml=self.yaml,
            urdf={name: robot.urdf for name, robot in self.robots.items()},
        )
