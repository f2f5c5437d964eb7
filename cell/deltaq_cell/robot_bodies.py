"""A robot's bodies: those of its URDF, and what is bolted to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.hull import Corners, HullError, hull_corners, hull_shape
from deltaq_cell.models import RobotModelError, Urdf, collision_names
from deltaq_cell.urdf_parsing import parse_geometry


def collision_geometry(
    urdf: Urdf,
    robot: str,
    T_world_base: pin.SE3,
    locked: Mapping[str, float],
    hulls: Mapping[str, Corners],
    bolted: list[pin.GeometryObject],
) -> pin.GeometryModel:
    """All collision bodies of a robot in the order of the joints that move them; meshes become convex hulls.

    Args:
        urdf: the robot's URDF; its bodies are named `robot/link`, or `robot/link_body` where a link has several.
        robot: the robot's name.
        T_world_base: pose of its root link.
        locked: joints that do not move, and where they stay [rad or m].
        hulls: of bodies whose meshes need not be read, by name without the robot's.
        bolted: attachments and tool bodies.

    Raises:
        RobotModelError: a mesh cannot be read or has no hull, or two bodies have one name.
    """
    names = collision_names(urdf)
    bodies = []
    parsed = parse_geometry(urdf, pin.GeometryType.COLLISION, T_world_base, locked, hulls)
    found = Counter(body.name.rsplit("_", 1)[0] for body in parsed.geometryObjects)
    for link, given in names.items():
        if found[link] != len(given):
            text = (
                f"{urdf.source}: link '{link}': {found[link]} of its {len(given)} collision bodies can be read; "
                "correct the link, such as an <inertial> without <inertia>"
            )
            raise RobotModelError(text, ("model",))
    for body in parsed.geometryObjects:
        link, index = body.name.rsplit("_", 1)  # pinocchio numbers the bodies of a link
        name = names[link][int(index)]
        try:
            if name in hulls:
                body.geometry = hull_shape(hulls[name])
            elif hasattr(body.geometry, "buildConvexHull"):
                body.geometry = hull_shape(hull_corners(np.array(body.geometry.vertices())))
        except HullError as error:
            raise RobotModelError(
                f"{urdf.source}: link '{link}', body '{name}': {error}", ("model",)
            ) from None
        body.name = f"{robot}/{name}"
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


def hulls_of(geometry: pin.GeometryModel, robot: str) -> dict[str, Corners]:
    """Corners of the hulls that were made of meshes, by the body's name without the robot's."""
    return {
        body.name.removeprefix(f"{robot}/"): tuple(
            (float(x), float(y), float(z))
            for x, y, z in (body.geometry.point(index) for index in range(body.geometry.num_points))
        )
        for body in geometry.geometryObjects
        if isinstance(body.geometry, coal.Convex)
    }
