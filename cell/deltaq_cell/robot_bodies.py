"""Bodies as coal geometry: those of a robot's URDF, bodies fixed to it, and the cell's structure."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
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
    RobotDescription,
    Shape,
)
from deltaq_cell.hull import Corners, HullError, hull_corners, hull_shape
from deltaq_cell.models import RobotModelError, Urdf, collision_names, nearest_name
from deltaq_cell.urdf_parsing import parse_geometry
from deltaq_protocol.arrays import Array


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
    """The structure's bodies in world coordinates, named `structure/pipe_1` and so on."""
    world = pin.SE3.Identity()
    return [
        body_geometry(f"structure/{name}", body, 0, world) for name, body in description.structure.items()
    ]


# What a robot carries: the frames of its tool, hands and camera, and the bodies that are bolted to its links.

FLANGE_LINKS = ("flange", "tool0")
"""The link that carries the tool, by name; a model without one carries it on its last link."""

PointName = str
"""A frame that a robot carries: `tool`, `camera`, or the name of one of its hands."""


class CarriedFrames:
    """Adds the frames of tool, hands and camera to a robot's model.

    Args:
        description: the robot as its cell describes it.
        name: the robot's name in the cell; its bodies' names begin with it (`fr/link_5`).
        model: `pinocchio.Model`, is added to.
        source: name of the model in errors.

    Attributes:
        hands: names of the frames that the robot works with: its hands', or `tool` alone.
        flange: index of the frame that carries the tool.

    Raises:
        RobotModelError: the description names a link that the model does not have.
    """

    def __init__(self, description: RobotDescription, name: str, model: pin.Model, source: str) -> None:
        self.hands: tuple[str, ...] = tuple(description.hands) or ("tool",)
        self._description = description
        self._name = name
        self._model = model
        self._source = source
        self.flange = self._flange_frame()
        self._frames = self._added()

    def of(self, point: PointName) -> int:
        """Index in `model.frames` of a frame that the robot carries: `tool`, `camera` or a hand.

        Raises:
            RobotModelError: the robot carries no such frame.
        """
        if point in self._frames:
            return self._frames[point]
        if point == "camera":
            raise RobotModelError(
                f"robot '{self._name}' carries no camera; add one under robots.{self._name}.camera"
            )
        raise RobotModelError(
            f"point must be one of {', '.join(self._frames)}, got {point!r}",
            suggestion=nearest_name(point, self._frames),
        )

    def with_tool(self, tool: str) -> CarriedFrames:
        """The same frames, `tool` being that of an exchangeable tool, or of the bare changer if it is empty."""
        other = copy.copy(self)
        other._frames = {**self._frames, "tool": self._frames[tool or "tool"]}
        return other

    def bolted_bodies(self) -> list[pin.GeometryObject]:
        """Attachments, and the bodies of tool, exchangeable tools or hands."""
        bolted = []
        for name, attachment in self._description.attachments.items():
            link = self._model.frames[self._link_frame(attachment.link, "attachments", name)]
            bolted.append(body_geometry(f"{self._name}/{name}", attachment, link.parentJoint, link.placement))
        carried = [("tool", self.flange, self._description.tool)]
        carried += [(name, self.flange, tool) for name, tool in self._description.tools.items()]
        for name, hand in self._description.hands.items():
            carried.append((name, self._link_frame(hand.link, "hands", name), hand))
        for prefix, frame, tool in carried:
            flange = self._model.frames[frame]
            for name, body in tool.bodies.items():
                full_name = f"{self._name}/{prefix}_{name}"
                bolted.append(body_geometry(full_name, body, flange.parentJoint, flange.placement))
        return bolted

    def _added(self) -> dict[PointName, int]:
        description = self._description
        frames = {}
        for name, hand in description.hands.items():
            frames[name] = self._add_frame(name, hand.frame, self._link_frame(hand.link, "hands", name))
        first = description.hands[self.hands[0]].frame if description.hands else description.tool.frame
        frames["tool"] = self._add_frame("tool", first, self.flange)
        for name, tool in description.tools.items():
            frames[name] = self._add_frame(name, tool.frame, self.flange)
        if description.camera is not None:
            frames["camera"] = self._add_frame("camera", description.camera.pose, self.flange)
        return frames

    def _flange_frame(self) -> int:
        if self._description.hands:
            first = self.hands[0]
            return self._link_frame(self._description.hands[first].link, "hands", first)
        links = [i for i, frame in enumerate(self._model.frames) if frame.type == pin.FrameType.BODY]
        named = [i for i in links if self._model.frames[i].name in FLANGE_LINKS]
        return (named or links)[-1]

    def _link_frame(self, link: str, *field: str) -> int:
        links = [frame.name for frame in self._model.frames if frame.type == pin.FrameType.BODY]
        if link not in links:
            raise RobotModelError(
                f"robot '{self._name}': no link '{link}' in {self._source}; it has {', '.join(links)}",
                (*field, "link"),
                nearest_name(link, links),
            )
        return int(self._model.getFrameId(link, pin.FrameType.BODY))

    def _add_frame(self, name: PointName, pose: Pose, link: int) -> int:
        carrier = self._model.frames[link]
        place = carrier.placement * placement(pose)
        frame = pin.Frame(f"deltaq_{name}", carrier.parentJoint, link, place, pin.FrameType.OP_FRAME)
        return int(self._model.addFrame(frame))


# Whether what was read as a robot can be one: its placements are rotations, its bodies of its own size. A mesh does
# not say its unit. Bodies in millimetres that are read as metres all overlap, and a check of distances that leaves out
# what always touches leaves them all out. Bodies in metres that are read as millimetres guard nothing. The bounds were
# chosen with some 150 public URDFs.

ROTATION_TOLERANCE = 1e-6
"""Greatest component of `R^T R - I`; rounding leaves 1e-15."""

LARGEST_BODY = 10.0
"""Greatest extent of a body by the robot's reach, or by `LEAST_REACH_M`; of public robots it is 2.4."""

LEAST_REACH_M = 0.5
"""A robot of less reach, such as a turntable, may have bodies as large as one of this reach."""

SMALLEST_LARGEST_BODY = 0.02
"""Least extent of a robot's largest body by its reach; of public robots it is 0.2."""

SMALLEST_MESH = 5e-4
"""Least extent of a mesh by the robot's reach: what is left of a link that is taken for a thousandth of its size."""


def check_rotations(model: Any, bodies: Iterable[Any], configurations: Sequence[Array], source: str) -> None:
    """Check that every placement of a model is a rotation and a finite translation.

    Args:
        model: pinocchio's.
        bodies: pinocchio geometry objects on its joints.
        configurations: (n,) each, at which the joints are placed.
        source: name of the model in errors.

    Raises:
        RobotModelError: one is not; the error names it.
    """
    data = model.createData()
    placed = [(f"frame '{frame.name}'", frame.placement) for frame in model.frames]
    placed += [(f"body '{body.name}'", body.placement) for body in bodies]
    placed += [
        (f"joint '{model.names[joint]}'", model.jointPlacements[joint]) for joint in range(1, model.njoints)
    ]
    for q in configurations:
        pin.forwardKinematics(model, data, q)
        placed += [
            (f"joint '{model.names[joint]}'", data.oMi[joint].copy()) for joint in range(1, model.njoints)
        ]
    rotations = np.array([place.rotation for _, place in placed])
    translations = np.array([place.translation for _, place in placed])
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3)).max(axis=(1, 2))
        sound = (off <= ROTATION_TOLERANCE) & (np.linalg.det(rotations) > 0)
    sound &= np.isfinite(translations).all(axis=1)
    if not sound.all():
        name = placed[int(np.argmin(sound))][0]
        raise RobotModelError(f"{source}: {name} has a placement that is not a rotation", ("model",))


def check_sizes(bodies: Sequence[Any], reach_m: float, source: str) -> None:
    """Check that no body of a robot is far larger or far smaller than the robot.

    Args:
        bodies: pinocchio geometry objects; not empty.
        reach_m: of the robot, see `reach`.
        source: name of the model in errors.

    Raises:
        RobotModelError: one is; the error names it.
    """
    extents = [extent(body) for body in bodies]
    largest, most = max(extents), LARGEST_BODY * max(reach_m, LEAST_REACH_M)
    for body, size in zip(bodies, extents, strict=True):
        is_small = size < SMALLEST_LARGEST_BODY * reach_m and size == largest
        is_small |= size < SMALLEST_MESH * reach_m and isinstance(body.geometry, coal.Convex)
        if is_small or not size <= most:
            raise RobotModelError(
                f"{source}: body '{body.name}' is {size:.4g} m long, on a robot that reaches {reach_m:.4g} m; is it in "
                "other units? give its mesh another scale, such as 0.001 for millimetres (the unit that a Collada file "
                "declares is applied already)",
                ("model",),
            )


def extent(body: Any) -> float:
    """The longest side of a body's box in its own frame [m]."""
    body.geometry.computeLocalAABB()
    box = body.geometry.aabb_local
    return float(np.max(box.max_ - box.min_))


def reach(model: Any, lower: Array, upper: Array, T_world_base: Any) -> float:
    """The greatest distance along the links from a robot's root to one of its frames [m].

    Args:
        model: pinocchio's, its joints revolute or prismatic, the base pose part of it.
        lower: (n,) limits of the joints.
        upper: likewise.
        T_world_base: pose of its root.
    """
    longest = [0.0]
    for joint in range(1, model.njoints):
        place = model.jointPlacements[joint]
        place = place if model.parents[joint] else T_world_base.actInv(place)
        travel = 0.0
        if not model.joints[joint].shortname().startswith("JointModelR"):
            travel = float(np.max(np.abs([lower[joint - 1], upper[joint - 1]])))
        longest.append(longest[model.parents[joint]] + float(np.linalg.norm(place.translation)) + travel)
    ends = [
        longest[int(frame.parentJoint)] + float(np.linalg.norm(frame.placement.translation))
        for frame in model.frames
        if frame.parentJoint
    ]
    return max(ends, default=0.0)
