"""Fills the kernel's arrays from a cell's model."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import Bodies, Extents, corners_of
from deltaq_cell.kernel.arrays import Anatomy, Findings, Placed
from deltaq_cell.kernel.span import VERTICES
from deltaq_protocol.arrays import Array


def anatomy_of(model: Any, structure: Sequence[Any], robots: Sequence[Bodies]) -> Anatomy:
    """The fixed data of a cell for the kernel: joints, bodies, and which joints move which body.

    Args:
        model: pinocchio's joint model of all robots.
        structure: geometry of the structure; these bodies come first.
        robots: the bodies of each robot, in the order of the model.
    """
    joints = model.nv
    rotation, translation = np.zeros((joints, 3, 3)), np.zeros((joints, 3))
    for joint in range(joints):
        rotation[joint] = model.jointPlacements[joint + 1].rotation
        translation[joint] = model.jointPlacements[joint + 1].translation
    axes, revolute = _axes(model)
    standing = len(structure)
    bodies = [*structure, *(item for robot in robots for item in robot.objects)]
    extents = [Extents(structure)] if standing else []
    extents += [robot.extents for robot in robots]
    most = max(extent.corners.shape[1] for extent in extents)
    corners = np.concatenate([_padded(extent.corners, most) for extent in extents])
    middle = (corners.max(axis=1) + corners.min(axis=1)) / 2
    box = np.zeros((len(bodies), 3))
    if standing:
        around = np.stack([corners_of(body) for body in structure])
        low, high = around.min(axis=1), around.max(axis=1)
        middle[:standing], box[:standing] = (low + high) / 2, (high - low) / 2
    owner = np.repeat(np.arange(-1, len(robots)), [standing, *(len(robot.objects) for robot in robots)])
    slices = [robot.slice_q for robot in robots]
    moved_by = np.zeros((len(bodies), joints), dtype=bool)
    for number, robot in enumerate(robots):
        moved_by[owner == number, robot.slice_q] = robot.moved_by
    axis, disc, ball = (
        np.concatenate([getattr(extent, name) for extent in extents]) for name in ("axis", "disc", "ball")
    )
    own = [_own(points) for points in corners]
    edges, box_centre, half_edges = zip(
        *(
            oriented_box(corners[body, : own[body]], axis[body], disc[body], ball[body])
            for body in range(len(bodies))
        ),
        strict=True,
    )
    return Anatomy(
        parent=np.array([model.parents[joint] - 1 for joint in range(1, joints + 1)], dtype=np.int64),
        rotation=rotation,
        translation=translation,
        joint_axis=axes,
        revolute=revolute,
        carrier=np.array([int(body.parentJoint) - 1 for body in bodies], dtype=np.int64),
        first_joint=np.array([0, *(item.start for item in slices)], dtype=np.int64)[owner + 1],
        last_joint=np.array([0, *(item.stop for item in slices)], dtype=np.int64)[owner + 1],
        moved_by=moved_by,
        robot=owner.astype(np.int64),
        corners=corners,
        corner_count=np.array(own, dtype=np.int64),
        axis=axis,
        disc=disc,
        ball=ball,
        middle=middle,
        radius=np.concatenate([np.zeros(standing), *(robot.radii for robot in robots)]),
        box=box,
        edges=np.array(edges),
        box_centre=np.array(box_centre),
        half_edges=np.array(half_edges),
    )


def placed_at_first(cell: Anatomy) -> Placed:
    """Placements before any robot was placed; only the structure has its final ones."""
    bodies, joints = cell.moved_by.shape
    return Placed(
        rotation=np.zeros((joints, 3, 3)),
        translation=np.zeros((joints, 3)),
        columns=np.zeros((joints, 6)),
        half=np.zeros(joints),
        vertices=np.ones(int(cell.robot.max()) + 1, dtype=np.int64),
        offset=np.zeros((VERTICES, joints)),
        along=np.zeros(joints),
        deviation=np.zeros(joints),
        corners=cell.corners.copy(),
        axis=cell.axis.copy(),
        centre=cell.middle.copy(),
        edges=cell.edges.copy(),
        box_centre=cell.box_centre.copy(),
        arms=np.zeros((bodies, joints)),
        travel=np.zeros(bodies),
    )


def findings(pairs: int) -> Findings:
    """Arrays for the findings of a query about that many pairs."""
    return Findings(
        room_m=np.zeros(pairs),
        travel_m=np.zeros(pairs),
        at_most_m=np.zeros(pairs),
        normal=np.zeros((pairs, 3)),
        open=np.zeros(pairs, dtype=bool),
        simplex=np.zeros((4, 3)),
        twist=np.zeros((2, VERTICES, 6)),
    )


def _axes(model: Any) -> tuple[Array, Any]:
    """Unit vectors of the joints' axes (joints, 3) in their own frames, and which joints are revolute (joints,)."""
    data = model.createData()
    # of a robot with one joint pinocchio gives a vector
    J = np.reshape(pin.computeJointJacobians(model, data, pin.neutral(model)), (6, -1))
    revolute = J[3:].any(axis=0)
    in_world = np.where(revolute, J[3:], J[:3]).T
    rotations = np.array([data.oMi[joint].rotation for joint in range(1, model.njoints)]).reshape(-1, 3, 3)
    axes = np.einsum("jki,jk->ji", rotations, in_world)
    return axes / np.linalg.norm(axes, axis=1)[:, None], revolute


def _padded(corners: Array, most: int) -> Array:
    """The same corners, the first repeated until each body has `most`."""
    missing = most - corners.shape[1]
    return np.concatenate([corners, np.repeat(corners[:, :1], missing, axis=1)], axis=1)


def _own(corners: Array) -> int:
    """How many corners come before the first one is repeated."""
    repeated = np.all(corners == corners[0], axis=1)
    return int(np.flatnonzero(~repeated)[-1]) + 1 if not repeated.all() else 1


def oriented_box(corners: Array, axis: Array, disc: float, ball: float) -> tuple[Array, Array, Array]:
    """The smallest of some boxes around a body: along its own frame, along its corners, or along its axis.

    Args:
        corners: (k, 3) of the body [m].
        axis: (3,) unit vector across which the disc lies.
        disc: radius, zero without [m].
        ball: radius, zero without [m].

    Returns:
        Rows of unit vectors along its edges (3, 3), its centre (3,) and half edges (3,) [m].
    """
    principal = np.linalg.svd(corners - corners.mean(axis=0))[2]
    about_axis = np.linalg.svd(axis[None])[2]
    boxes = [_along(axes, corners, axis, disc, ball) for axes in (np.eye(3), principal, about_axis)]
    return min(boxes, key=lambda box: float(np.prod(box[2])))


def _along(axes: Array, corners: Array, axis: Array, disc: float, ball: float) -> tuple[Array, Array, Array]:
    reach = corners @ axes.T
    # a disc reaches along a unit vector as far as that is across its axis
    wider = disc * np.linalg.norm(_cross(axes, axis), axis=1) + ball
    low, high = reach.min(axis=0) - wider, reach.max(axis=0) + wider
    return axes, axes.T @ ((low + high) / 2), (high - low) / 2


def _cross(rows: Array, vector: Array) -> Array:
    """What `np.cross` gives, without its detours through axes in any order: there are some hundred bodies."""
    (x, y, z), (a, b, c) = rows.T, vector
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
