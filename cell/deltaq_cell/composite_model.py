"""All robots of a cell in one pinocchio model, so that bodies of different robots can be measured at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pinocchio as pin

from deltaq_cell.cell_model import CellModel

WORLD = 0
"""pinocchio's index of the joint that does not move."""


@dataclass(frozen=True)
class JointRange:
    """Where one robot's joints begin in the joined model."""

    first_joint: int
    first_q: int

    def moved(self, body: Any) -> Any:
        """A copy of a robot's body on its joint of the joined model, with a shape object of its own."""
        joint = body.parentJoint + self.first_joint if body.parentJoint != WORLD else WORLD
        return pin.GeometryObject(body.name, joint, body.placement, body.geometry.clone())


def composite_model(cell: CellModel) -> tuple[Any, dict[str, JointRange]]:
    """One `pinocchio.Model` of all robots of a cell, and each robot's place in it."""
    model = pin.Model()
    places = {}
    for name, robot in cell.robots.items():
        place = places[name] = JointRange(model.njoints - 1, model.nq)
        for joint in range(1, robot.model.njoints):
            parent = robot.model.parents[joint]
            model.addJoint(
                parent + place.first_joint if parent != WORLD else WORLD,
                robot.model.joints[joint],
                robot.model.jointPlacements[joint],
                f"{name}/{robot.model.names[joint]}",
            )
    return model, places
