"""Prepares a URDF for pinocchio: checks its numbers, and rewrites elements that pinocchio does not accept."""

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from deltaq_cell.find import find_file
from deltaq_cell.models import RobotModelError, Urdf, collision_names, nearest_name

UNLIMITED = 1e9
"""Limits of a joint that has none of its own [rad, rad/s]; the cell's description has others."""

MOST_M = 1000.0
"""Greatest length in a URDF [m]."""

AXIS_LENGTHS = (1e-6, 1e6)
"""Lengths of a joint's axis that are taken for those of a unit vector written with other digits."""

SIZES = {
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "box": {"size": 3},
}
"""Shapes, and how many numbers each of their attributes has."""

_INDICES = re.compile(r"[-0-9\s]*")
"""Of the corners of Collada's faces; a face may be marked with -1."""


class MissingMeshError(RobotModelError):
    """A mesh that a URDF names is not found."""


def parse_model(urdf: Urdf, locked: Mapping[str, float]) -> Any:
    """The `pinocchio.Model` of a URDF.

    Args:
        urdf: the robot's.
        locked: joints that do not move, and their positions [rad or m]; joints that mimic one of them do not move.

    Raises:
        RobotModelError: the text is not a URDF, a number in it cannot be, or a joint cannot be locked at its position.
    """
    tree = urdf.tree()
    _judge_joints(urdf, tree)
    for link in tree.findall("link"):
        _judge_link(urdf, link)
    model = _built(urdf, tree)
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
    for link in tree.findall("link"):
        for index, body in enumerate(link.findall("collision" if is_collision else "visual")):
            geometry = body.find("geometry")
            mesh = None if geometry is None else geometry.find("mesh")
            if geometry is None or mesh is None:
                continue
            if is_collision and names[link.get("name", "")][index] in known:
                geometry.remove(mesh)
                ElementTree.SubElement(geometry, "sphere", radius="1")
            else:
                _find(urdf, link, mesh)
    model = _built(urdf, tree)
    text = ElementTree.tostring(tree, encoding="unicode")
    try:
        geometry_model = pin.buildGeomFromUrdfString(model, text, kind)
    except (ValueError, RuntimeError) as error:
        raise RobotModelError(
            f"{urdf.source}: its bodies cannot be read: {_line(error)}", ("model",)
        ) from None
    joints, q = _locks(urdf, model, locked)
    if joints:
        _, geometry_model = pin.buildReducedModel(model, geometry_model, joints, q)
    for item in geometry_model.geometryObjects:
        if item.parentJoint == 0:
            item.placement = T_world_base * item.placement
    return geometry_model


def _built(urdf: Urdf, tree: ElementTree.Element) -> Any:
    """The model of a tree, which is changed for it: a continuous joint becomes a revolute one with distant limits."""
    for joint in tree.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity=f"{UNLIMITED:g}")
            limit.set("lower", f"{-UNLIMITED:g}")
            limit.set("upper", f"{UNLIMITED:g}")
    try:
        return pin.buildModelFromXML(ElementTree.tostring(tree, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise RobotModelError(f"{urdf.source}: not a URDF model: {_line(error)}", ("model",)) from None


def _line(error: Exception) -> str:
    """What pinocchio or coal says, in one line, without the file and function of theirs."""
    return " ".join(str(error).rpartition("message: ")[2].split())


def _locks(urdf: Urdf, model: Any, locked: Mapping[str, float]) -> tuple[list[int], Any]:
    """Indices of the joints that are locked, and a configuration that has them where they stay."""
    names = list(model.names)[1:]
    places = dict(locked)
    mimics = _mimics(urdf, urdf.tree())
    for name in mimics:
        followed, scale, offset = name, 1.0, 0.0
        while followed not in locked and followed in mimics:
            followed, multiplier, further = mimics[followed]
            scale, offset = scale * multiplier, scale * further + offset
        if followed in locked:
            places[name] = scale * locked[followed] + offset
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


def _judge_joints(urdf: Urdf, tree: ElementTree.Element) -> None:
    """Refuse joints of which the model would not be that of a robot.

    Raises:
        RobotModelError: a placement, an axis or a limit is no number or too large, or mimics are in a circle.
    """
    for joint in tree.findall("joint"):
        what = f"joint '{joint.get('name', '')}'"
        _judge_origin(urdf, what, joint)
        axis = joint.find("axis")
        if axis is not None and joint.get("type") in ("revolute", "continuous", "prismatic", "planar"):
            length = math.hypot(*_numbers(urdf, what, axis, "xyz", 3, None))
            least, most = AXIS_LENGTHS
            if not least <= length <= most:
                text = f"{urdf.source}: {what}: its axis '{axis.get('xyz')}' has no direction; give a unit vector"
                raise RobotModelError(text, ("model",))
        limit = joint.find("limit")
        for name in ("lower", "upper", "velocity", "effort"):
            if limit is not None and math.isnan(_numbers(urdf, what, limit, name, 1, 0.0)[0]):
                raise RobotModelError(f"{urdf.source}: {what}: its limit {name} is not a number", ("model",))
    mimics = _mimics(urdf, tree)
    for name in mimics:
        followed, seen = name, {""}
        while followed in mimics:
            if followed in seen:
                text = f"{urdf.source}: joint '{name}' mimics itself indirectly; let it mimic an independent joint"
                raise RobotModelError(text, ("model",))
            seen.add(followed)
            followed = mimics[followed][0]


def _mimics(urdf: Urdf, tree: ElementTree.Element) -> dict[str, tuple[str, float, float]]:
    """By joint the one that it mimics, the multiplier and the offset [rad or m]."""
    found = {}
    joints = {joint.get("name", ""): joint for joint in tree.findall("joint")}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        what, followed = f"joint '{name}'", mimic.get("joint", "")
        if followed not in joints:
            raise RobotModelError(
                f"{urdf.source}: {what} mimics '{followed}', which is not a joint", ("model",)
            )
        multiplier, offset = (
            _numbers(urdf, what, mimic, key, 1, default)[0]
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        if not math.isfinite(multiplier * offset):
            raise RobotModelError(f"{urdf.source}: {what}: its mimic has numbers without bounds", ("model",))
        found[name] = followed, multiplier, offset
    return found


def _judge_link(urdf: Urdf, link: ElementTree.Element) -> None:
    """Judge the sizes and placements of a link's bodies as those of a cell's own; a visual body may have no size.

    Raises:
        RobotModelError: one is no number, out of bounds, or a size that is not above zero.
    """
    for kind in ("collision", "visual"):
        for number, body in enumerate(link.findall(kind), start=1):
            what = f"link '{link.get('name', '')}', {kind} {number}"
            _judge_origin(urdf, what, body)
            for shape in body.iterfind("geometry/*"):
                for attribute, count in SIZES.get(shape.tag, {}).items():
                    for size in _numbers(urdf, what, shape, attribute, count, None):
                        if not abs(size) <= MOST_M or (size <= 0 and kind == "collision"):
                            text = (
                                f"{urdf.source}: {what}: {attribute} of its {shape.tag} is {size:g}; it must be more "
                                f"than 0 and at most {MOST_M:g} m"
                            )
                            raise RobotModelError(text, ("model",))
                if shape.tag == "mesh":
                    scale = _numbers(urdf, what, shape, "scale", 3, 1.0)
                    if not all(0 < abs(factor) <= MOST_M for factor in scale):
                        text = f"{urdf.source}: {what}: its mesh's scale is '{shape.get('scale')}'; none may be 0"
                        raise RobotModelError(text, ("model",))


def _judge_origin(urdf: Urdf, what: str, element: ElementTree.Element) -> None:
    origin = element.find("origin")
    if origin is None:
        return
    for attribute, unit, most in (("xyz", "m", MOST_M), ("rpy", "rad", MOST_M)):
        for value in _numbers(urdf, what, origin, attribute, 3, 0.0):
            if not abs(value) <= most:
                text = (
                    f"{urdf.source}: {what}: {attribute} of its origin has {value:g}; at most {most:g} {unit}"
                )
                raise RobotModelError(text, ("model",))


def _numbers(
    urdf: Urdf, what: str, element: ElementTree.Element, attribute: str, count: int, default: float | None
) -> list[float]:
    """The numbers of an attribute; `default` if there is none and it may be left out.

    Raises:
        RobotModelError: it is missing, or has another count of numbers.
    """
    text = element.get(attribute)
    if text is None and default is not None:
        return [default] * count
    try:
        numbers = [float(part) for part in (text or "").split()]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        wanted = "a number" if count == 1 else f"{count} numbers"
        got = "is missing" if text is None else f"is '{text[:80]}'"
        message = f"{urdf.source}: {what}: {attribute} of <{element.tag}> {got}; it must be {wanted}"
        raise RobotModelError(message, ("model",))
    return numbers


def _find(urdf: Urdf, link: ElementTree.Element, mesh: ElementTree.Element) -> None:
    """Set a mesh's file to the one that was found, and its scale to one into metres if the file has other units."""
    what = f"{urdf.source}: link '{link.get('name')}'"
    try:
        path = find_file(mesh.get("filename", ""), urdf.folder)
    except FileNotFoundError as error:
        raise MissingMeshError(f"{what}: {error}", ("model",)) from None
    mesh.set("filename", str(path))
    if path.suffix.lower() == ".dae":
        try:
            unit = collada_unit(path)
        except (OSError, ValueError, LookupError, expat.ExpatError) as error:
            raise RobotModelError(f"{what}: mesh {path} cannot be read: {error}", ("model",)) from None
        if unit != 1.0:
            scale = _numbers(urdf, what, mesh, "scale", 3, 1.0)
            mesh.set("scale", " ".join(repr(factor * unit) for factor in scale))


def collada_unit(path: Path) -> float:
    """Metres per unit of a Collada file (COLLADA 1.4.1, `asset/unit`); coal takes every unit for a metre.

    Raises:
        OSError: it cannot be read.
        ExpatError: it is no XML.
        LookupError: its encoding is unknown.
        ValueError: the unit is not a positive number, or what should be an index of a corner is none.
    """
    inside: list[str] = []
    units = ["1"]

    def start(name: str, attributes: dict[str, str]) -> None:
        inside.append(name)
        if inside[1:] == ["asset", "unit"]:
            units.append(attributes.get("meter", "1"))

    def data(text: str) -> None:
        if inside[-1] in ("p", "v", "h", "vcount") and not _INDICES.fullmatch(text):
            raise ValueError(f"<{inside[-1]}> contains a value that is no index")  # assimp would never end

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: inside.pop()
    parser.CharacterDataHandler = data
    with path.open("rb") as file:
        for piece in iter(partial(file.read, 1 << 16), b""):
            parser.Parse(piece)
    parser.Parse(b"", True)
    unit = float(units[-1])
    if not 0 < unit <= MOST_M:
        raise ValueError(f"its unit is {units[-1]} m")
    return unit
