"""The effect of a fault, from the emulated controller's own record of setpoints."""

import numpy as np
from pydantic import BaseModel

from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array
from deltaq_testing.oracle import TELEGRAM_STEP, limit_violations

ABRUPT_PER_CYCLE = 2
"""Abrupt changes of a setpoint that rests for one cycle: a stop and a start."""


NEVER = "never"
BY_ITSELF = "by itself"


def recovery_text(steps: list[str]) -> str:
    """The steps of the recovery, in order."""
    return ", ".join(steps) or BY_ITSELF


class StoppingMotion(BaseModel, frozen=True):
    """How a robot moved from the cycle of a fault on.

    Attributes:
        braked_after_cycles: KRC cycles until the first increment below cruise; None if the robot kept moving.
        rest_after_s: until the last increment; None if it moved to the end.
        travel_rad: of the joint that went furthest, until rest [rad or m]; None if it moved to the end.
        travel_tool_m: path of the tool until rest; None if it moved to the end.
    """

    braked_after_cycles: int | None
    rest_after_s: float | None
    travel_rad: float | None
    travel_tool_m: float | None


class Kept(BaseModel, frozen=True):
    """Limits and distances over a whole run, start and recovery included.

    Attributes:
        position_violations, velocity_violations: setpoints beyond a limit, counted by joint and cycle.
        unanswered_cycles: KRC cycles without a valid reply, in which a KRC holds its last correction.
        altered_telegrams: telegrams of the KRC in which the wire changed a digit. If the values are implausible, the
            Robot Server answers with the last correction, which acts like no answer.
        altered_replies: whether the wire changed digits in replies to the KRC. The setpoints that the KRC then accepts
            or refuses are not those of the Robot Server; only distances are judged.
        abrupt_cycles: changes of an increment beyond the acceleration limit; each unanswered cycle explains two, and
            each altered telegram.
        clearance_m: least distance between robots, and between robots and structure.
        self_clearance_m: least distance between two bodies of one robot.
        protest: message with which the KRC refused a setpoint; None if it accepted all.
    """

    position_violations: int
    velocity_violations: int
    unanswered_cycles: int
    altered_telegrams: int
    altered_replies: bool
    abrupt_cycles: int
    clearance_m: float
    self_clearance_m: float
    protest: str | None


class FaultEffect(BaseModel, frozen=True):
    """One fault and its effect.

    Attributes:
        phase, reason: of the robot while the fault stood, once it was at rest or at the end.
        named_after_s: from the fault until the robot was held; None if it never was.
        recovery: actions until it moved again, in order; "by itself" for none, "never" if all failed.
        good: no limit passed, nothing refused by the KRC, no unexplained abrupt cycle, stop distances kept, and it
            moved again.
    """

    fault: str
    what: str
    live: bool
    motion: StoppingMotion
    phase: str
    reason: str | None
    named_after_s: float | None
    recovery: str
    kept: Kept
    good: bool


class FaultTable(BaseModel, frozen=True):
    """The table of faults."""

    cell: str
    robot: str
    cycle_s: float
    cruise_rad_s: float
    rows: tuple[FaultEffect, ...]

    @property
    def good(self) -> bool:
        """Whether every row is good."""
        return all(row.good for row in self.rows)


def motion_after(robot: RobotModel, setpoints: Array, cycle_s: float, cruise: float) -> StoppingMotion:
    """Measure from setpoints (m, n) [rad or m], the first of which was sent before the fault.

    Args:
        robot: the robot.
        setpoints: consecutive ones of the emulated controller, to the end of the fault.
        cycle_s: time between two of them.
        cruise: largest joint increment of a cycle before the fault [rad or m].
    """
    steps = np.abs(np.diff(setpoints, axis=0)).max(axis=1)
    slower = np.flatnonzero(steps < cruise - 4 * TELEGRAM_STEP)
    braked = int(slower[0]) + 1 if slower.size else None
    moving = np.flatnonzero(steps > 2 * TELEGRAM_STEP)
    last = int(moving[-1]) + 1 if moving.size else 0
    if last + 5 > len(steps):
        return StoppingMotion(
            braked_after_cycles=braked, rest_after_s=None, travel_rad=None, travel_tool_m=None
        )
    tool = np.array([robot.forward(q)[:3, 3] for q in setpoints[: last + 1]])
    return StoppingMotion(
        braked_after_cycles=braked,
        rest_after_s=last * cycle_s,
        travel_rad=float(np.abs(setpoints[last] - setpoints[0]).max()),
        travel_tool_m=float(np.linalg.norm(np.diff(tool, axis=0), axis=1).sum()),
    )


def judged(
    robot: RobotModel,
    setpoints: Array,
    cycle_s: float,
    unanswered: int,
    near: tuple[float, float],
    protest: str | None,
    altered: int = 0,
    altered_replies: bool = False,
) -> Kept:
    """Judge a whole run.

    Args:
        robot: the robot.
        setpoints: (m, n) consecutive ones of the emulated controller [rad or m].
        cycle_s: time between two of them.
        unanswered: KRC cycles without a valid reply.
        near: least distance of bodies, and least distance of a robot to itself [m].
        protest: of the KRC.
        altered: number of telegrams of the KRC in which the wire changed a digit.
        altered_replies: whether the wire changed digits in replies.
    """
    beyond = limit_violations(robot, setpoints, cycle_s)
    return Kept(
        position_violations=beyond.position_violations,
        velocity_violations=beyond.velocity_violations,
        unanswered_cycles=unanswered,
        altered_telegrams=altered,
        altered_replies=altered_replies,
        abrupt_cycles=beyond.acceleration_violations,
        clearance_m=near[0],
        self_clearance_m=near[1],
        protest=protest,
    )


def is_good(result: Kept, stop_distances_m: tuple[float, float], tolerance_m: float = 1e-4) -> bool:
    """Whether limits and stop distances were kept; `tolerance_m` allows for the decimals of telegrams."""
    still = result.unanswered_cycles + result.altered_telegrams
    as_sent = (
        result.protest is None
        and result.position_violations == 0
        and result.velocity_violations == 0
        and result.abrupt_cycles <= ABRUPT_PER_CYCLE * still
    )
    return (
        (as_sent or result.altered_replies)
        and result.clearance_m >= stop_distances_m[0] - tolerance_m
        and result.self_clearance_m >= stop_distances_m[1] - tolerance_m
    )
