"""A robot's description from its URDF, with the source of each limit."""

import copy
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import ArrayLike

from deltaq.obstacles import GateError, numbers, positive
from deltaq_cell.convex_parts import convex_parts
from deltaq_cell.description import RobotDescription
from deltaq_cell.hull import Corners, HullError
from deltaq_cell.models import RobotModelError, Urdf, collision_names, load_urdf
from deltaq_cell.urdf_parsing import UNLIMITED, parse_geometry, parse_model

RAMP_S = 0.4
"""Time to full speed where no file gives an acceleration: `acceleration = velocity / RAMP_S` [s]."""

TURNS = 4 * math.pi
"""Limits of a continuous joint, which has none of its own [rad]."""

LIMIT_REMEDY = "give the joint a <limit> with lower, upper, effort and velocity"

Limit = tuple[float, str]
"""A limit and its source."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of one joint, each with its source [rad or m, per s, per s^2]."""

    lower: Limit
    upper: Limit
    velocity: Limit
    acceleration: Limit


def described(
    urdf: str | Path,
    srdf: str | Path | None,
    joint_limits: str | Path | None,
    locked: Mapping[str, float],
    q: ArrayLike | None,
    tolerance: float,
) -> tuple[RobotDescription, dict[str, str]]:
    """A robot's description, and the source of each of its limits by `joint.limit`.

    Args:
        urdf: file, name of a shipped model or `package://`.
        srdf: file with the pairs of links that are never checked; None if there is none.
        joint_limits: MoveIt's `joint_limits.yaml`; None for that beside the SRDF, if any.
        locked: joints that do not move, and where they are [rad or m].
        q: (n,) start; None for zero, or the middle of a joint's limits if zero is outside [rad or m].
        tolerance: permitted deviation of each joint from its setpoints [rad or m].

    Raises:
        GateError: a limit is missing or cannot be, or a file cannot be read.
        RobotModelError: the URDF cannot be read.
    """
    for name, place in locked.items():
        numbers(f"locked.{name}", [place], 1, "give where the joint is, in rad or m")
    source = load_urdf(str(urdf))
    joints_told = source.tree().findall("joint")
    told = {joint.get("name", ""): joint.find("limit") for joint in joints_told}
    for joint in joints_told:
        limit = told[joint.get("name", "")]
        for what in ("velocity", "effort"):  # without them no URDF is read, and nothing says why
            if joint.get("type") in ("revolute", "prismatic") and (limit is None or limit.get(what) is None):
                raise GateError(f"{joint.get('name')}.{what}", None, "must be given", LIMIT_REMEDY)
    model = parse_model(source, locked)
    beside = None if srdf is None else Path(srdf).with_name("joint_limits.yaml")
    if joint_limits is None and beside is not None and beside.is_file():
        joint_limits = beside
    given = {} if joint_limits is None else _joint_limits(joint_limits)
    limits = {}
    for index, name in enumerate(list(model.names)[1:]):
        bounds = model.lowerPositionLimit[index], model.upperPositionLimit[index], model.velocityLimit[index]
        limits[name] = _limits(name, bounds, told.get(name), given.get(name, {}))
    start = _start(q, limits)
    joints = {
        name: _joint(model.joints[index + 1].shortname(), limit, float(start[index]), tolerance)
        for index, (name, limit) in enumerate(limits.items())
    }
    links = {link for link, bodies in collision_names(source).items() if bodies}
    never = () if srdf is None else _disabled(srdf, links)
    description = RobotDescription.model_validate(
        {
            "model": str(urdf),
            "driver": {"kind": "kinematic"},
            "joints": joints,
            "locked_joints": dict(locked),
            "never_checked": never,
        }
    )
    sources = {
        f"{name}.{what}": f"{value:.6g}, {where}"
        for name, limit in limits.items()
        for what, (value, where) in vars(limit).items()
    }
    return description, sources


def in_convex_parts(urdf: str | Path, locked: Mapping[str, float]) -> tuple[Urdf, dict[str, Corners]]:
    """The URDF with a collision body for each convex part of a mesh, and the hulls of these bodies by name.

    A mesh of one part keeps its name; those of several have `_part1` and so on after it.

    Args:
        urdf: file, name of a shipped model or `package://`.
        locked: joints that do not move, and where they are [rad or m].

    Raises:
        RobotModelError: the URDF or a mesh cannot be read.
    """
    source = load_urdf(str(urdf))
    names, tree = collision_names(source), source.tree()
    parts: dict[str, list[Corners]] = {}
    for body in parse_geometry(
        source, pin.GeometryType.COLLISION, pin.SE3.Identity(), locked
    ).geometryObjects:
        link, index = body.name.rsplit("_", 1)  # pinocchio numbers the bodies of a link
        mesh, name = body.geometry, names[link][int(index)]
        if hasattr(mesh, "buildConvexHull"):
            faces = [
                [int(mesh.tri_indices(face)[corner]) for corner in range(3)] for face in range(mesh.num_tris)
            ]
            try:
                parts[name] = convex_parts(np.array(mesh.vertices())[faces])
            except HullError as error:
                text = f"{source.source}: link '{link}', body '{name}': {error}"
                raise RobotModelError(text, ("model",)) from None
    made: dict[str, list[Corners | None]] = {}
    for element in tree.findall("link"):
        link = element.get("name", "")
        made[link] = []
        for name, whole in zip(names[link], element.findall("collision"), strict=True):
            found = parts.get(name, [None])
            own = name.removeprefix(link).lstrip("_")
            element.remove(whole)
            for number, corners in enumerate(found, start=1):
                part = copy.deepcopy(whole)
                suffix = f"part{number}" if len(found) > 1 else ""
                part.set("name", "_".join(filter(None, (own, suffix))))
                element.append(part)
                made[link].append(corners)
    split = Urdf(ElementTree.tostring(tree, encoding="unicode"), source.source, source.folder)
    named = collision_names(split)
    hulls = {
        name: corners
        for link, bodies in made.items()
        for name, corners in zip(named[link], bodies, strict=True)
        if corners is not None
    }
    return split, hulls


def whole_body(part: str) -> str:
    """The name of the body of a URDF that a body of `in_convex_parts` is a part of."""
    return re.sub(r"_part\d+$", "", part)


def _limits(
    name: str, bounds: tuple[float, float, float], told: ElementTree.Element | None, given: dict[str, Any]
) -> JointLimits:
    lower, upper, velocity = map(float, bounds)
    where = "URDF"
    if upper >= UNLIMITED:
        lower, upper, where = -TURNS, TURNS, "two turns either way, since the joint is continuous"
    if given.get("has_position_limits", True):
        if (least := given.get("min_position")) is not None and least > lower:
            lower, where = float(least), "joint_limits.yaml"
        if (most := given.get("max_position")) is not None and most < upper:
            upper, where = float(most), "joint_limits.yaml"
    remedy = f"{LIMIT_REMEDY}, or name it in `locked`"
    if not lower < upper:
        raise GateError(f"{name}.upper", upper, f"must be above lower, {lower:g}", remedy)
    speed = velocity, "URDF"
    if given.get("has_velocity_limits", True) and "max_velocity" in given:
        speed = min(speed, (float(given["max_velocity"]), "joint_limits.yaml"))
    if not math.isfinite(speed[0]) or not 0.0 < speed[0] < UNLIMITED:
        raise GateError(f"{name}.velocity", speed[0], "must be above 0 and finite", remedy)
    acceleration = speed[0] / RAMP_S, f"velocity / {RAMP_S:g} s, since no file gives one"
    text = None if told is None else told.get("acceleration")
    remedy = "give one above 0 in the URDF or in joint_limits.yaml"
    if given.get("has_acceleration_limits", True) and "max_acceleration" in given:
        acceleration = float(given["max_acceleration"]), "joint_limits.yaml"
    elif text is not None:
        acceleration = float(numbers(f"{name}.acceleration", [text], 1, remedy, 1e6)[0]), "URDF"
    positive(f"{name}.acceleration", acceleration[0], 1e6, remedy)
    return JointLimits((lower, where), (upper, where), speed, acceleration)


def _start(q: ArrayLike | None, limits: Mapping[str, JointLimits]) -> Any:
    if q is None:
        pairs = [(limit.lower[0], limit.upper[0]) for limit in limits.values()]
        return np.array([0.0 if low <= 0.0 <= high else (low + high) / 2 for low, high in pairs])
    start = numbers("q", q, len(limits), f"give one number for each of {', '.join(limits)}")
    for value, (name, limit) in zip(start, limits.items(), strict=True):
        if not limit.lower[0] <= value <= limit.upper[0]:
            bound = f"{name} must be within its limits, {limit.lower[0]:.6g} to {limit.upper[0]:.6g}"
            raise GateError("q", float(value), bound, "start elsewhere")
    return start


def _joint(kind: str, limit: JointLimits, home: float, tolerance: float) -> dict[str, float]:
    lower, upper = limit.lower[0], limit.upper[0]
    if kind.startswith("JointModelP"):
        return {
            "home_m": home,
            "lower_m": lower,
            "upper_m": upper,
            "max_velocity_m_s": limit.velocity[0],
            "max_acceleration_m_s2": limit.acceleration[0],
            "tracking_tolerance_m": tolerance,
        }
    return {
        "home_deg": math.degrees(home),
        "lower_deg": math.degrees(lower),
        "upper_deg": math.degrees(upper),
        "max_velocity_deg_s": math.degrees(limit.velocity[0]),
        "max_acceleration_rad_s2": limit.acceleration[0],
        "tracking_tolerance_deg": math.degrees(tolerance),
    }


def _joint_limits(path: str | Path) -> dict[str, dict[str, Any]]:
    """Limits by joint, as MoveIt's `joint_limits.yaml` has them."""
    remedy = "give MoveIt's joint_limits.yaml"
    try:
        found = yaml.safe_load(Path(path).read_text(encoding="utf-8"))["joint_limits"]
        for name, limits in found.items():
            for key, value in limits.items():
                if not key.startswith("has_"):
                    number = "a truth value" if isinstance(value, bool) else value
                    numbers(f"joint_limits.{name}.{key}", [number], 1, "give a number", 1e6)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        text = f"{path}: {type(error).__name__}"
        raise GateError("joint_limits", text, "must be a file with joint_limits", remedy) from None
    return dict(found)


def _disabled(path: str | Path, links: set[str]) -> tuple[tuple[str, str], ...]:
    """Pairs of links that an SRDF leaves out; links without bodies are passed over."""
    try:
        tree = ElementTree.parse(Path(path))
    except (OSError, ElementTree.ParseError) as error:
        raise GateError("srdf", f"{path}: {error}", "must be a readable SRDF", "give its path") from None
    pairs = [(item.get("link1", ""), item.get("link2", "")) for item in tree.iter("disable_collisions")]
    return tuple(pair for pair in pairs if links.issuperset(pair))
