"""Data of the gate's kernel: arrays that are filled once for a cell, and arrays that each call reuses.

Bodies are those of all robots and of the structure, joints those of all robots, each in the order of the cell. All
lengths are in m, angles in rad, and everything that is placed is in the world.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.arrays import Array, Flags

Integers = NDArray[np.int64]


class Anatomy(NamedTuple):
    """The constant data of a cell: its kinematic tree and its bodies.

    Attributes:
        parent: (joints,) the joint before each, -1 for none.
        rotation: (joints, 3, 3) of each joint's frame in that of the joint before, at q = 0.
        translation: (joints, 3) likewise [m].
        joint_axis: (joints, 3) unit vectors in the joints' own frames.
        revolute: (joints,) False for prismatic ones.
        carrier: (bodies,) the joint that carries each, -1 for what stands still.
        first_joint: (bodies,) of the robot that it belongs to; of the structure zero.
        last_joint: (bodies,) one more than the last joint of that robot; of the structure zero.
        moved_by: (bodies, joints) which joints move which body.
        robot: (bodies,) number of the robot that it belongs to, -1 for the structure.
        corners: (bodies, k, 3) in the frames of the carriers [m].
        corner_count: (bodies,) how many corners are a body's own.
        axis: (bodies, 3) across which the discs lie, in the frames of the carriers.
        disc: (bodies,) radii, zero for bodies without [m].
        ball: (bodies,) radii, zero for bodies without [m].
        middle: (bodies, 3) of the ball around a body, or of the box around one that stands [m].
        radius: (bodies,) of that ball, zero for a box [m].
        box: (bodies, 3) half edges of that box along the world's axes, zero for a ball [m].
        edges: (bodies, 3, 3) rows of unit vectors along the edges of the tight box around a body, in the frames of
            the carriers.
        box_centre: (bodies, 3) of that box, likewise [m].
        half_edges: (bodies, 3) of that box [m].
    """

    parent: Integers
    rotation: Array
    translation: Array
    joint_axis: Array
    revolute: Flags
    carrier: Integers
    first_joint: Integers
    last_joint: Integers
    moved_by: Flags
    robot: Integers
    corners: Array
    corner_count: Integers
    axis: Array
    disc: Array
    ball: Array
    middle: Array
    radius: Array
    box: Array
    edges: Array
    box_centre: Array
    half_edges: Array


class Placed(NamedTuple):
    """Placements of the robots of a cell, each in a span of joint space.

    Attributes:
        rotation: (joints, 3, 3) of the joints' frames.
        translation: (joints, 3) [m].
        columns: (joints, 6) of the geometric Jacobian at the world's origin, linear first.
        half: (joints,) half-widths of a box around the span.
        vertices: (robots,) how many vertices the span of each robot has.
        offset: (VERTICES, joints) of its vertices from the middle of that box.
        along: (joints,) the greatest of them.
        deviation: (joints,) how far the span is wide.
        corners: (bodies, k, 3) [m].
        axis: (bodies, 3).
        centre: (bodies, 3) of balls and boxes [m].
        edges: (bodies, 3, 3) rows of unit vectors along the edges of the tight boxes.
        box_centre: (bodies, 3) of those [m].
        arms: (bodies, joints) greatest distances of points from the axes, zero where the span has no width
            [m/rad or m/m].
        travel: (bodies,) bound of the travel of any point within the span [m].
    """

    rotation: Array
    translation: Array
    columns: Array
    half: Array
    vertices: Integers
    offset: Array
    along: Array
    deviation: Array
    corners: Array
    axis: Array
    centre: Array
    edges: Array
    box_centre: Array
    arms: Array
    travel: Array


class PlacedBody(NamedTuple):
    """One body where it is placed: corners, widened by a ball and by a disc across its axis (`deltaq_cell.bodies`).

    Attributes:
        corners: (k, 3), of which the first `corner_count` are its own [m].
        corner_count: of them.
        axis_x: with y and z the unit vector across which the disc lies.
        axis_y: likewise.
        axis_z: likewise.
        disc: radius, zero without [m].
        ball: radius, zero without [m].
    """

    corners: Array
    corner_count: int
    axis_x: float
    axis_y: float
    axis_z: float
    disc: float
    ball: float


class Pairs(NamedTuple):
    """Pairs of bodies to be checked.

    Attributes:
        first: (pairs,) number of the one body.
        second: (pairs,) number of the other.
        stop_m: (pairs,) stop distances [m].
        active: (pairs,) whether they are looked at now.
    """

    first: Integers
    second: Integers
    stop_m: Array
    active: Flags


class Findings(NamedTuple):
    """Findings of a query, with space for the longest list of pairs.

    Attributes:
        room_m: (pairs,) lower bounds of swept distance beyond stop distance, good enough to decide [m].
        travel_m: (pairs,) how far both bodies travel together [m].
        at_most_m: (pairs,) upper bounds of the distance at the middle, of pairs that were searched [m].
        normal: (pairs, 3) from first to second body, unit vectors of pairs that were searched.
        open: (pairs,) whether a pair has not been shown to have the room asked for.
        simplex: (4, 3) of the search between two bodies.
        twist: (2, VERTICES, 6) of two bodies, from the middle of their spans to each vertex.
    """

    room_m: Array
    travel_m: Array
    at_most_m: Array
    normal: Array
    open: Flags
    simplex: Array
    twist: Array
