"""A whole cell, modelled: its description, its robots and its structure, built once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from deltaq_cell.description import CellDescription, RobotDescription
from deltaq_cell.hull import Corners
from deltaq_cell.identity import cell_identity
from deltaq_cell.load import load_with_text
from deltaq_cell.robot import RobotModel
from deltaq_cell.robot_bodies import structure_geometry
from deltaq_protocol import messages
from deltaq_protocol.codec import MAX_ZENOH_MESSAGE_BYTES, pack, to_line
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.identity import CellIdentity
from deltaq_protocol.messages import CarriedFrame, JointPlacement, RobotKinematics, Row

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
        description: the fields of its YAML.
        robots: name to model, in the order of the description.
        structure: fixed bodies, in world coordinates, named `structure/...`.
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

    def with_tools(self, tools: Mapping[str, str | None]) -> CellModel:
        """The cell with the tools that are coupled now, by robot; see `RobotModel.with_tool`."""
        robots = {name: robot.with_tool(tools.get(name)) for name, robot in self.robots.items()}
        return self if robots == self.robots else replace(self, robots=robots)

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
            coupled={name: None for name, robot in self.robots.items() if robot.tool_bodies},
        )
        length = max(len(pack(message)), len(to_line(message)))
        if length > MOST_TOLD_BYTES:
            parts = {f"the URDF of {name}": len(text) for name, text in message.urdf.items()} | {
                "the YAML": len(message.yaml)
            }
            longest = max(parts, key=lambda part: parts[part])
            raise LongDescriptionError(
                f"the description of cell {cell.cell} is {length} bytes long; the greatest size for clients is "
                f"{MOST_TOLD_BYTES}; the longest part is {longest} with {parts[longest]}"
            )
        return message


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


# A robot's kinematics for clients: numbers only, so that a client needs neither YAML nor URDF.


def told_kinematics(robot: RobotModel) -> RobotKinematics:
    """Where each joint and each carried frame (`tool`, `camera`, hands, exchangeable tools) is, in joint order."""
    names = (
        *robot.hands,
        "tool",
        *robot.tool_bodies,
        *(("camera",) if robot.description.camera is not None else ()),
    )
    frames = {name: robot.model.frames[robot.frame_of(name)] for name in names}
    return RobotKinematics(
        joints=tuple(_joint(robot, index) for index in range(robot.n)),
        frames={
            name: CarriedFrame(joint=int(frame.parentJoint) - 1, T_joint_frame=_rows(frame.placement))
            for name, frame in frames.items()
        },
    )


def joint_axis(robot: RobotModel, index: int) -> tuple[float, float, float]:
    """The axis of a joint in its own frame: a unit vector, along which or about which it moves."""
    model = robot.model
    # at any configuration: in its own frame a joint's axis is constant
    J = pin.computeJointJacobian(model, model.createData(), pin.neutral(model), index + 1)
    motion = np.reshape(J, (6, -1))[:, index]  # of a robot with one joint pinocchio gives a vector
    x, y, z = np.asarray(motion[3:] if robot.revolute[index] else motion[:3]).round(15).tolist()
    return x, y, z


def _joint(robot: RobotModel, index: int) -> JointPlacement:
    return JointPlacement(
        parent=int(robot.model.parents[index + 1]) - 1,
        T_parent_joint=_rows(robot.model.jointPlacements[index + 1]),
        axis=joint_axis(robot, index),
    )


def _rows(pose: pin.SE3) -> tuple[Row, Row, Row, Row]:
    first, second, third, last = (tuple(row) for row in pose.homogeneous.tolist())
    return first, second, third, last
