"""A URDF as pinocchio reads it, which needs help with some joints and file names of public URDFs."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from deltaq_cell.models import RobotModelError, Urdf, collision_names, nearest_name
from deltaq_cell.packages import find_file

UNLIMITED = 1e9
"""Limits of a joint that has none of its own [rad, rad/s]; the cell's description has others."""


class MissingMeshError(RobotModelError):
    """A mesh that a URDF names is not found."""


def parse_model(urdf: Urdf, locked: Mapping[str, float]) -> Any:
    """The `pinocchio.Model` of a URDF.

    Args:
        urdf: the robot's.
        locked: joints that do not move, and their positions [rad or m]; joints that mimic one of them do not move.

    Raises:
        RobotModelError: the text is not a URDF, or a joint cannot be locked at its position.
    """
    model = _built(urdf, urdf.tree())
    joints, q = _locks(urdf, model, locked)
    return pin.buildReducedModel(model, joints, q) if joints else model


def parse_geometry(
    urdf: Urdf,
    kind: Any,
    T_world_base: pin.SE3,
    locked: Mapping[str, float],
    known: Collection[str] = (),
) -> pin.GeometryModel:
    """The bodies of a URDF; bodies that no joint moves are placed in the world.

    Args:
        urdf: the robot's.
        kind: `pinocchio.GeometryType.COLLISION` or `VISUAL`.
        T_world_base: pose of the robot's root link.
        locked: as for `parse_model`.
        known: collision bodies whose meshes are not read; a sphere takes their place.

    Raises:
        MissingMeshError: a mesh is not found.
        RobotModelError: a mesh is not readable.
    """
    tree = urdf.tree()
    is_collision = kind == pin.GeometryType.COLLISION
    names = collision_names(urdf)
    for link in tree.iter("link"):
        for index, body in enumerate(link.findall("collision" if is_collision else "visual")):
            geometry = body.find("geometry")
            mesh = None if geometry is None else geometry.find("mesh")
            if geometry is None or mesh is None:
                continue
            if is_collision and names[link.get("name", "")][index] in known:
                geometry.remove(mesh)
                ElementTree.SubElement(geometry, "sphere", radius="1")
            else:
                mesh.set("filename", _found(urdf, link, mesh))
    model = _built(urdf, tree)
    text = ElementTree.tostring(tree, encoding="unicode")
    try:
        geometry_model = pin.buildGeomFromUrdfString(model, text, kind)
    except ValueError as error:
        raise RobotModelError(f"{urdf.source}: its bodies cannot be read: {error}", ("model",)) from None
    joints, q = _locks(urdf, model, locked)
    if joints:
        _, geometry_model = pin.buildReducedModel(model, geometry_model, joints, q)
    for item in geometry_model.geometryObjects:
        if item.parentJoint == 0:
            item.placement = T_world_base * item.placement
    return geometry_model


def _built(urdf: Urdf, tree: ElementTree.Element) -> Any:
    """The model of a tree, which is changed for it: a continuous joint becomes a revolute one with distant limits."""
    for joint in tree.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity=f"{UNLIMITED:g}")
            limit.set("lower", f"{-UNLIMITED:g}")
            limit.set("upper", f"{UNLIMITED:g}")
    try:
        return pin.buildModelFromXML(ElementTree.tostring(tree, encoding="unicode"))
    except ValueError as error:
        raise RobotModelError(f"{urdf.source}: not a URDF model: {error}", ("model",)) from None


def _locks(urdf: Urdf, model: Any, locked: Mapping[str, float]) -> tuple[list[int], Any]:
    """Indices of the joints that are locked, and a configuration that has them where they stay."""
    names = list(model.names)[1:]
    places = dict(locked)
    for joint in urdf.tree().iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint") in locked:
            followed = locked[mimic.get("joint", "")]
            place = _number(urdf, mimic, "multiplier", 1.0) * followed + _number(urdf, mimic, "offset", 0.0)
            places.setdefault(joint.get("name", ""), place)
    q, joints = pin.neutral(model), []
    for name, place in places.items():
        field = ("locked_joints", name)
        if name not in names:
            text = f"no joint '{name}' in {urdf.source} to lock; it has {', '.join(names)}"
            raise RobotModelError(text, field, nearest_name(name, names))
        number = names.index(name) + 1
        if model.joints[number].nq != 1:
            raise RobotModelError(f"joint '{name}' of {urdf.source} is neither revolute nor prismatic", field)
        at = model.joints[number].idx_q
        lower, upper = model.lowerPositionLimit[at], model.upperPositionLimit[at]
        if not lower - 1e-9 <= place <= upper + 1e-9:
            text = f"joint '{name}' of {urdf.source} cannot be locked at {place:g}: it goes from {lower:g} to {upper:g}"
            raise RobotModelError(text, field)
        q[at] = place
        joints.append(number)
    return joints, np.array(q)


def _number(urdf: Urdf, element: ElementTree.Element, attribute: str, default: float) -> float:
    text = element.get(attribute)
    try:
        return default if text is None else float(text)
    except ValueError:
        raise RobotModelError(f"{urdf.source}: {attribute} is no number: {text!r}", ("model",)) from None


def _found(urdf: Urdf, link: ElementTree.Element, mesh: ElementTree.Element) -> str:
    try:
        return str(find_file(mesh.get("filename", ""), urdf.folder))
    except FileNotFoundError as error:
        raise MissingMeshError(f"{urdf.source}: link '{link.get('name')}': {error}", ("model",)) from None
