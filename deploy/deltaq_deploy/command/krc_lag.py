"""`deltaq krc lag`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_deploy.command.console import print_json, print_table
from deltaq_deploy.command.options import CellOption, JsonOption, RobotOption, TokenOption, UrlOption
from deltaq_deploy.launch import BAD
from deltaq_protocol.errors import DeltaqError

if TYPE_CHECKING:
    from deltaq_deploy.rsi.lag_sweep import DrivenSweep, MeasuredAxis
    from deltaq_protocol.blocking import BlockingCell, BlockingRobot


def lag(
    robot: RobotOption,
    cell: CellOption = "lab",
    url: UrlOption = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the steps of all axes into this file.")
    ] = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Measure how far the drives of a running robot lag: it moves each axis a little, slowly, through the gate.

    Each axis makes a step of at most 0.5 deg or 1 mm and a sweep of 3 deg or 30 mm at a tenth of its speed. Ctrl-C
    brings the robot to rest. Exit status 1 if an axis lags more than the cell's gate.servo_lag_s.
    """
    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.cell_connection import Where, connect

    where = Where.of(cell, url, robot)
    presumed_s = load_cell(cell).gate.servo_lag_s if url is None else None
    with connect(where, "deltaq krc lag", token) as running:
        cycle_s = running.description.cycle_s
        _require_ready(running, robot)
        with running.lease(robot) as leased:
            courses = _courses(leased, cycle_s, quiet=json)
    measured = _measured(leased.summary.joints, courses, cycle_s)
    if output is not None:
        _draw(output, leased.summary.joints, courses, cycle_s)
    _report(robot, measured, presumed_s, cycle_s, json)


def _require_ready(running: BlockingCell, robot: str) -> None:
    from deltaq_cell.drive_lag import least_servo_lag_s

    status = running.status().robots[robot]
    if status.reason == "drive_lag":
        joints = running.robots[robot].joints
        known = ((axis, lag_s) for axis, lag_s in zip(joints, status.lag_s, strict=True) if lag_s is not None)
        axis, longest_s = max(known, key=lambda one: one[1], default=("?", 0.0))
        least_s = least_servo_lag_s(longest_s, running.description.cycle_s)
        raise DeltaqError(
            f"{robot} is held: axis {axis} lagged {longest_s * 1e3:.0f} ms in the probe of its session, more than the "
            f"gate presumes; set gate.servo_lag_s to at least {least_s:g}, start the cell again, and measure anew"
        )
    if status.phase != "ready":
        why = f" ({status.reason})" if status.reason else ""
        raise DeltaqError(
            f"{robot} is {status.phase}{why}, and has to be ready: deltaq reset --robot {robot}"
        )


def _courses(leased: BlockingRobot, cycle_s: float, quiet: bool) -> list[DrivenSweep]:
    """Drive each motion, one increment a state, and keep its states."""
    from deltaq_deploy.rsi.lag_sweep import DrivenSweep, motions

    states = leased.states()
    state = next(states)
    courses, axis = [], -1
    for motion in motions(leased.summary, state.q_cmd, cycle_s):
        if motion.axis != axis:
            axis = motion.axis
            typer.echo(f"axis {leased.summary.joints[axis]} ...", err=quiet)
        seen = [state]
        for increment in motion.increments:
            dq = [0.0] * len(state.q)
            dq[axis] = float(increment)
            leased.send(dq)
            state = next(states)
            if state.phase == "held":
                raise DeltaqError(
                    f"{leased.name} was held ({state.reason}) while {leased.summary.joints[axis]} moved"
                )
            seen.append(state)
        courses.append(DrivenSweep.of(motion, seen))
    return courses


def _measured(
    joints: Sequence[str], courses: Sequence[DrivenSweep], cycle_s: float
) -> dict[str, MeasuredAxis]:
    from deltaq_deploy.rsi.lag_sweep import measured_axis

    measured = {}
    for axis, joint in enumerate(joints):
        try:
            measured[joint] = measured_axis([course for course in courses if course.axis == axis], cycle_s)
        except ValueError as error:
            raise DeltaqError(
                f"axis {joint}: {error}; is something else moving it, or did the gate hold it back? "
                "Measure in free space"
            ) from error
    return measured


def _report(
    robot: str, measured: dict[str, MeasuredAxis], presumed_s: float | None, cycle_s: float, json: bool
) -> None:
    from deltaq_cell.drive_lag import REMAINDER, lag_fault, least_servo_lag_s

    settled_s = [one.lag.settled_s for one in measured.values()]
    moving_s = [one.moving_s for one in measured.values()]
    least_s, spread_s = least_servo_lag_s(max(settled_s), cycle_s), max(moving_s) - min(moving_s)
    fault = "" if presumed_s is None else lag_fault(list(measured), settled_s, presumed_s, cycle_s)
    if json:
        axes = {
            axis: {
                "dead_s": round(one.lag.dead_s, 4),
                "half_s": round(one.lag.half_s, 4),
                "settled_s": round(one.lag.settled_s, 4) if math.isfinite(one.lag.settled_s) else None,
                "overshoot": round(one.lag.overshoot, 3),
                "moving_s": round(one.moving_s, 4),
            }
            for axis, one in measured.items()
        }
        print_json(
            {
                "robot": robot,
                "axes": axes,
                "spread_s": round(spread_s, 4),
                "presumed_s": presumed_s,
                "least_servo_lag_s": least_s if math.isfinite(least_s) else None,
                "fault": fault,
            }
        )
    else:
        rows = [
            (axis, *(f"{value * 1e3:.0f}" for value in _figures(one)), f"{one.lag.overshoot:.1%}")
            for axis, one in measured.items()
        ]
        columns = ("axis", "dead time", "half", f"{1 - REMAINDER:.0%}, settled", "in motion", "overshoot")
        print_table(f"{robot}: lag from setpoint to measurement [ms]", columns, rows)
        typer.echo(f"spread between the axes in motion: {spread_s * 1e3:.0f} ms")
        typer.echo(fault or f"gate.servo_lag_s has to be at least {least_s:g}")
    if fault:
        raise typer.Exit(BAD)


def _figures(one: MeasuredAxis) -> tuple[float, ...]:
    return one.lag.dead_s, one.lag.half_s, one.lag.settled_s, one.moving_s


def _draw(path: Path, joints: Sequence[str], courses: Sequence[DrivenSweep], cycle_s: float) -> None:
    """Draw each axis' first step and first sweep, sent and measured, as fractions of their size."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, rows = pyplot.subplots(len(joints), 2, figsize=(9, 1.6 * len(joints)), squeeze=False)
    for axis, joint in enumerate(joints):
        for panel, is_step in zip(rows[axis], (True, False), strict=True):
            course = next(one for one in courses if one.axis == axis and one.is_step == is_step)
            times_s = (course.cycles - course.cycles[0]) * cycle_s
            way = course.q_cmd[-1] - course.q_cmd[0]
            panel.plot(times_s, (course.q_cmd - course.q_cmd[0]) / way, label="sent")
            panel.plot(times_s, (course.q - course.q[0]) / way, label="measured")
            panel.set_ylabel(joint)
    rows[0][0].set_title("step")
    rows[0][1].set_title("sweep")
    rows[0][0].legend()
    for panel in rows[-1]:
        panel.set_xlabel("time [s]")
    figure.tight_layout()
    figure.savefig(path)
    typer.echo(f"drawn: {path}", err=True)
