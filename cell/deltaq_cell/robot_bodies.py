"""A robot's bodies: those of its URDF, and what is bolted to it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from deltaq_cell.hull import hull_corners, hull_shape
from deltaq_cell.models import RobotModelError, Urdf, collision_names


def parse_geometry(urdf: Urdf, kind: Any, T_world_base: pin.SE3) -> pin.GeometryModel:
    """The bodies of a URDF, those that no joint moves placed in the world.

    Args:
        urdf: the robot's URDF.
        kind: `pinocchio.GeometryType.COLLISION` or `VISUAL`.
        T_world_base: pose of the robot's root link.

    Raises:
        RobotModelError: a mesh is not found or not readable.
    """
    # a model of its own: the parser wants the model as it was parsed, without the base pose or frames of ours
    model = pin.buildModelFromXML(urdf.text)
    folders = [str(folder) for folder in urdf.package_dirs]
    try:
        geometry = pin.buildGeomFromUrdfString(model, urdf.text, kind, package_dirs=folders)
    except ValueError as error:
        raise RobotModelError(f"{urdf.source}: its bodies cannot be read: {error}", ("model",)) from None
    for body in geometry.geometryObjects:
        if body.parentJoint == 0:
            body.placement = T_world_base * body.placement
    return geometry


def collision_geometry(
    urdf: Urdf, robot: str, T_world_base: pin.SE3, bolted: list[pin.GeometryObject]
) -> pin.GeometryModel:
    """All collision bodies of a robot in the order of the joints that move them; meshes become convex hulls.

    Args:
        urdf: the robot's URDF; its bodies are named `robot/link`, or `robot/link_body` where a link has several.
        robot: the robot's name.
        T_world_base: pose of its root link.
        bolted: attachments and tool bodies.

    Raises:
        RobotModelError: a mesh cannot be read, or two bodies have one name.
    """
    names = collision_names(urdf)
    parsed = parse_geometry(urdf, pin.GeometryType.COLLISION, T_world_base)
    bodies = []
    for body in parsed.geometryObjects:
        link, index = body.name.rsplit("_", 1)  # pinocchio numbers the bodies of a link
        body.name = f"{robot}/{names[link][int(index)]}"
        if hasattr(body.geometry, "buildConvexHull"):
            body.geometry = hull_shape(hull_corners(np.array(body.geometry.vertices())))
        bodies.append(body)
    geometry = pin.GeometryModel()
    for body in sorted([*bodies, *bolted], key=lambda body: int(body.parentJoint)):
        if geometry.existGeometryName(body.name):
            raise RobotModelError(
                f"robot '{robot}': two bodies are named '{body.name}'; rename the attachment or tool body",
                ("attachments",),
            )
        geometry.addGeometryObject(body)
    return geometry
