"""The kernel's courses: what a robot is sent if it takes a share of a request, and the brake after it.

`deltaq_services.sim.tube` and `deltaq_protocol.brake` say the same in plain words; tests hold them together to the bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from deltaq_cell.compiled import compiled
from deltaq_cell.kernel.pieces import Tube
from deltaq_protocol.arrays import Array

_ROUNDING = 1e-9
"""As `deltaq_protocol.brake` has it."""


class Course(NamedTuple):
    """Every course between a brake and a request, by its share of the request.

    Attributes:
        points: (k, n) setpoints: those before the share, and room for those after it [rad or m].
        before: how many come before it, past and in flight.
        now: which of them is the present one.
        lag: how many setpoints back the drives may be.
        tolerance: (n,) how far each joint may be beside the hull of its setpoints at rest [rad or m].
        spread: half of the greatest difference between the lags of two joints [cycles].
        brake: (n,) increment at a share of 0 [rad or m].
        request: (n,) increment at a share of 1.
        max_dv: (n,) largest change of the increment between two cycles.
        dq: (n,) the increment at the share that was laid last.
        joints: the robot's first joint, and one more than its last.
        bodies: the same of its bodies.
    """

    points: Array
    before: int
    now: int
    lag: int
    tolerance: Array
    spread: float
    brake: Array
    request: Array
    max_dv: Array
    dq: Array
    joints: tuple[int, int]
    bodies: tuple[int, int]


@compiled
def lay_course(course: Course, share: float) -> Tube:
    """The tube of a course; its points are those of `course`, and are good until another share is laid.

    Raises:
        IndexError: if there is no room for the setpoints of its brake.
    """
    points, dq, joints = course.points, course.dq, len(course.brake)
    most, moves = 0.0, False
    for joint in range(joints):
        dq[joint] = course.brake[joint] + share * (course.request[joint] - course.brake[joint])
        most = max(most, abs(dq[joint]) / course.max_dv[joint])
        moves = moves or dq[joint] != 0.0
    cycles = max(1, math.ceil(most * (1.0 - _ROUNDING))) if moves else 0
    count, travel = course.before + cycles, 0.0
    if count > len(points):
        raise IndexError("no room for the setpoints of a brake")
    for step in range(cycles):
        travel += (cycles - step) / cycles
        for joint in range(joints):
            points[course.before + step, joint] = points[course.before - 1, joint] + travel * dq[joint]
    moves = False
    for k in range(count):
        for joint in range(joints):
            moves = moves or points[k, joint] != points[count - 1, joint]
    last = count - 1 + course.lag if moves else course.now
    return Tube(
        points[:count],
        course.lag,
        course.now,
        last,
        course.tolerance,
        course.spread,
        course.joints,
        course.bodies,
    )
