"""Courses: the setpoints of a robot that executes a share of a request, and of the brake after it.

`deltaq_services.sim.tube` and `deltaq_protocol.brake` say the same in plain words; tests hold them together to the bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled, makes_no_array
from deltaq_cell.kernel.pieces import Tube
from deltaq_protocol.arrays import Array

_ROUNDING = 1e-9
"""As `deltaq_protocol.brake` has it."""


class Course(NamedTuple):
    """The setpoints of a robot for every share from a brake (0) to a request (1).

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
    """The tube of a course at a share; its points are a view of `course`, valid until the next call.

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


# What the gate computes of a few joints' numbers in every decision.


@makes_no_array
def keeps_limits(
    brake: Array,
    request: Array,
    share: float,
    last_dq: Array,
    q_cmd: Array,
    max_dq: Array,
    max_dv: Array,
    lower: Array,
    upper: Array,
    slack: float,
    rounding: float,
) -> bool:
    """Whether neither `Limits.dynamic_scale` nor `Limits.position_scale` would leave less than a share of a request.

    Args:
        brake: (n,) next increment of the brake [rad or m].
        request: (n,) increment asked for.
        share: 0 for the brake, 1 for the whole request.
        last_dq: (n,) increment sent last.
        q_cmd: (n,) setpoint.
        max_dq: (n,) largest increment.
        max_dv: (n,) its largest change.
        lower: (n,) least position.
        upper: (n,) greatest.
        slack: fraction of a bound by which rounding may exceed it.
        rounding: how far beyond a position limit a sum of increments may end.
    """
    most = 0.0
    for joint in range(len(brake)):
        slowest = max(-max_dq[joint], last_dq[joint] - max_dv[joint])
        fastest = min(max_dq[joint], last_dq[joint] + max_dv[joint])
        change = request[joint] - brake[joint]
        if change != 0.0:
            room = (fastest if change > 0.0 else slowest) - brake[joint]
            if not room / change >= share - slack:
                return False
        most = max(most, abs(brake[joint] + share * change) / max_dv[joint])
    cycles = max(1.0, math.ceil(most * (1.0 - slack)))
    for joint in range(len(brake)):
        dq = brake[joint] + share * (request[joint] - brake[joint])
        end = q_cmd[joint] + dq * ((cycles + 1.0) / 2.0)
        above = end - max(upper[joint], q_cmd[joint])
        below = min(lower[joint], q_cmd[joint]) - end
        if not max(above, below) <= rounding:
            return False
    return True


@compiled
def course_points(past: Array, path: Array, dq: Array, brake_cycles: int, step: int) -> tuple[Array, bool]:
    """All setpoints of a course, and whether any of them differ.

    Args:
        past: (m, n) setpoints before [rad or m].
        path: (k, n) setpoints in flight.
        dq: (n,) increment that follows.
        brake_cycles: length of its brake.
        step: of it that was sent last; -1 before `dq` itself.
    """
    joints, moves = len(dq), False
    for joint in range(joints):
        moves = moves or dq[joint] != 0.0
    before = len(past) + len(path)
    to_come = max(0, brake_cycles - step - 1) if moves else 0
    points = np.empty((before + to_come, joints))
    # by numbers: for whole rows numba compiles what says that their shapes differ, for three seconds
    for joint in range(joints):
        for k in range(len(past)):
            points[k, joint] = past[k, joint]
        for k in range(len(path)):
            points[len(past) + k, joint] = path[k, joint]
    travel = 0.0
    for k in range(to_come):
        travel += (brake_cycles - (step + 1 + k)) / brake_cycles
        for joint in range(joints):
            points[before + k, joint] = points[before - 1, joint] + travel * dq[joint]
    moves = False
    for k in range(len(points)):
        for joint in range(joints):
            moves = moves or points[k, joint] != points[len(points) - 1, joint]
    return points, moves
