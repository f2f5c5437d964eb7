"""Bodies of the cell as coal geometry: its structure, and the attachments of its robots."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.description import (
    Body,
    BoxShape,
    CapsuleShape,
    CellDescription,
    CylinderShape,
    Pose,
    Shape,
)


def placement(pose: Pose) -> pin.SE3:
    """A pose of the description as a pinocchio placement: maps its own coordinates into its parent's."""
    roll, pitch, yaw = np.deg2rad(pose.rpy_deg)
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array(pose.position_m))


def coal_shape(shape: Shape) -> Any:
    """A shape of the description as a coal shape, its frame at its centre and cylinders along z."""
    if isinstance(shape, BoxShape):
        return coal.Box(*shape.size_m)
    if isinstance(shape, CylinderShape):
        return coal.Cylinder(shape.radius_m, shape.length_m)
    if isinstance(shape, CapsuleShape):
        return coal.Capsule(shape.radius_m, shape.length_m)
    return coal.Sphere(shape.radius_m)


def body_geometry(name: str, body: Body, parent_joint: int, parent: pin.SE3) -> pin.GeometryObject:
    """One body as a geometry object.

    Args:
        name: name of the object.
        body: its shape and its pose in the parent frame.
        parent_joint: index of the joint that moves it; 0 is the world.
        parent: placement of the parent frame in that joint's frame.
    """
    geometry = pin.GeometryObject(name, parent_joint, parent * placement(body.pose), coal_shape(body.shape))
    geometry.meshColor = np.array(body.colour_rgba)
    return geometry


def structure_geometry(description: CellDescription) -> list[pin.GeometryObject]:
    """Everything that stands in the cell, in world coordinates, named `structure/pipe_1` and so on."""
    world = pin.SE3.Identity()
    return [
        body_geometry(f"structure/{name}", body, 0, world) for name, body in description.structure.items()
    ]
