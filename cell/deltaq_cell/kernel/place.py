"""The kernel's kinematics: placements of a robot's bodies, and their greatest travel within a box of joint space.

The same as `deltaq_cell.bodies` and pinocchio say. A body travels at most `sum_j half_j * r_j`
(`deltaq_cell.proximity`).
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined, makes_no_array
from deltaq_cell.kernel.arrays import Anatomy, Placed
from deltaq_protocol.arrays import Array, Flags


@makes_no_array
def place(
    cell: Anatomy,
    placed: Placed,
    joints: tuple[int, int],
    bodies: tuple[int, int],
    wanted: Flags,
    middle: Array,
    half: Array,
) -> float:
    """Place one robot at the middle of a box; returns the greatest travel of those of its bodies that are placed [m].

    Args:
        cell: the fixed data of the cell.
        placed: receives the result.
        joints: the robot's first joint, and one more than its last.
        bodies: its first body, and one more than its last.
        wanted: (bodies,) whether each body of the cell is to be placed.
        middle: (n,) middle of the box [rad or m]; further elements are ignored.
        half: (n,) half-widths of the box [rad or m]; further elements are ignored.
    """
    first, last = joints
    for joint in range(first, last):
        placed.half[joint] = half[joint - first]
        _place_joint(cell, placed, joint, middle[joint - first])
    greatest = 0.0
    for body in range(bodies[0], bodies[1]):
        if not wanted[body]:
            continue
        _place_body(cell, placed, body)
        travel = 0.0
        for joint in range(first, last):
            arm = _arm(cell, placed, body, joint) if placed.half[joint] > 0.0 else 0.0
            placed.arms[body, joint] = arm
            travel += arm * placed.half[joint]
        placed.travel[body] = travel
        greatest = max(greatest, travel)
    return greatest


@makes_no_array
def spread(
    cell: Anatomy,
    placed: Placed,
    joints: tuple[int, int],
    bodies: tuple[int, int],
    offset: Array,
    vertices: int,
    deviation: Array,
) -> None:
    """Set the span of a robot within the box at whose middle it was placed.

    Args:
        cell: the fixed data of the cell.
        placed: receives the result.
        joints: the robot's first joint, and one more than its last.
        bodies: its first body, and one more than its last.
        offset: (vertices, n) offsets of the span's vertices from the middle [rad or m]; further elements are ignored.
        vertices: number of vertices.
        deviation: (n,) half-width of the span beside its vertices [rad or m]; further elements are ignored.
    """
    if bodies[0] < bodies[1]:
        placed.vertices[cell.robot[bodies[0]]] = vertices
    for joint in range(joints[0], joints[1]):
        placed.along[joint] = 0.0
        placed.deviation[joint] = deviation[joint - joints[0]]
        for vertex in range(vertices):
            placed.offset[vertex, joint] = offset[vertex, joint - joints[0]]
            placed.along[joint] = max(placed.along[joint], abs(placed.offset[vertex, joint]))


@inlined
def _place_joint(cell: Anatomy, placed: Placed, joint: int, q: float) -> None:
    """Placement of a joint's frame, after its parent's, and its column of the Jacobian."""
    x, y, z = cell.joint_axis[joint, 0], cell.joint_axis[joint, 1], cell.joint_axis[joint, 2]
    R, p, here, parent = placed.rotation, placed.translation, cell.rotation[joint], cell.parent[joint]
    for row in range(3):
        if parent < 0:
            r0, r1, r2 = here[row, 0], here[row, 1], here[row, 2]
            p[joint, row] = cell.translation[joint, row]
        else:
            a, b, c = R[parent, row, 0], R[parent, row, 1], R[parent, row, 2]
            r0 = a * here[0, 0] + b * here[1, 0] + c * here[2, 0]
            r1 = a * here[0, 1] + b * here[1, 1] + c * here[2, 1]
            r2 = a * here[0, 2] + b * here[1, 2] + c * here[2, 2]
            shift = cell.translation[joint]
            p[joint, row] = p[parent, row] + a * shift[0] + b * shift[1] + c * shift[2]
        axis = r0 * x + r1 * y + r2 * z
        placed.columns[joint, row] = axis
        if cell.revolute[joint]:
            # a row r turns to cos r + sin (r x axis) + (1 - cos) (r . axis) axis
            cos, sin = math.cos(q), math.sin(q)
            R[joint, row, 0] = cos * r0 + sin * (r1 * z - r2 * y) + (1.0 - cos) * axis * x
            R[joint, row, 1] = cos * r1 + sin * (r2 * x - r0 * z) + (1.0 - cos) * axis * y
            R[joint, row, 2] = cos * r2 + sin * (r0 * y - r1 * x) + (1.0 - cos) * axis * z
        else:
            R[joint, row, 0], R[joint, row, 1], R[joint, row, 2] = r0, r1, r2
            p[joint, row] += q * axis
    column, at = placed.columns[joint], p[joint]
    if cell.revolute[joint]:
        column[3], column[4], column[5] = column[0], column[1], column[2]
        column[0] = at[1] * column[5] - at[2] * column[4]
        column[1] = at[2] * column[3] - at[0] * column[5]
        column[2] = at[0] * column[4] - at[1] * column[3]
    else:
        column[3] = column[4] = column[5] = 0.0


@inlined
def _place_body(cell: Anatomy, placed: Placed, body: int) -> None:
    joint = cell.carrier[body]
    if joint < 0:
        return  # it stands where it stood
    for row in range(3):
        a, b, c = (
            placed.rotation[joint, row, 0],
            placed.rotation[joint, row, 1],
            placed.rotation[joint, row, 2],
        )
        shift = placed.translation[joint, row]
        for corner in range(cell.corner_count[body]):
            x, y, z = (
                cell.corners[body, corner, 0],
                cell.corners[body, corner, 1],
                cell.corners[body, corner, 2],
            )
            placed.corners[body, corner, row] = a * x + b * y + c * z + shift
        axis, middle, centre = cell.axis[body], cell.middle[body], cell.box_centre[body]
        placed.axis[body, row] = a * axis[0] + b * axis[1] + c * axis[2]
        placed.centre[body, row] = a * middle[0] + b * middle[1] + c * middle[2] + shift
        placed.box_centre[body, row] = a * centre[0] + b * centre[1] + c * centre[2] + shift
        for k in range(3):
            edge = cell.edges[body, k]
            placed.edges[body, k, row] = a * edge[0] + b * edge[1] + c * edge[2]


@inlined
def _arm(cell: Anatomy, placed: Placed, body: int, joint: int) -> float:
    """Greatest travel of a point of a body per unit of a joint [m/rad or m/m]."""
    if not cell.moved_by[body, joint]:
        return 0.0
    if not cell.revolute[joint]:
        return 1.0
    column = placed.columns[joint]
    vx, vy, vz, wx, wy, wz = column[0], column[1], column[2], column[3], column[4], column[5]
    most = 0.0
    for corner in range(cell.corner_count[body]):
        x, y, z = (
            placed.corners[body, corner, 0],
            placed.corners[body, corner, 1],
            placed.corners[body, corner, 2],
        )
        a = wy * z - wz * y + vx
        b = wz * x - wx * z + vy
        c = wx * y - wy * x + vz
        most = max(most, a * a + b * b + c * c)
    return float(math.sqrt(most) + cell.disc[body] + cell.ball[body])
