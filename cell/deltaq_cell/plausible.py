"""Whether what was read as a robot can be one: its placements are rotations, its bodies of its own size.

A mesh does not say its unit. Bodies in millimetres that are read as metres all overlap, and a check of distances that
leaves out what always touches leaves them all out. Bodies in metres that are read as millimetres guard nothing.
The bounds were chosen with some 150 public URDFs: see each of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.models import RobotModelError
from deltaq_protocol.arrays import Array

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
        source: what an error calls the model.

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
        raise RobotModelError(f"{source}: {name} is placed by something that is not a rotation", ("model",))


def check_sizes(bodies: Sequence[Any], reach_m: float, source: str) -> None:
    """Check that no body of a robot is far larger or far smaller than the robot.

    Args:
        bodies: pinocchio geometry objects; not empty.
        reach_m: of the robot, see `reach`.
        source: what an error calls the model.

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
