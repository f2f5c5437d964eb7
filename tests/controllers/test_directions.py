"""How far the hands go along each axis, beside what decoupled mode did before and a public library does.

The library is pink 4.4.0 with quadprog 0.1.14: a task for each hand (cost 1 per m and .5 per rad), a posture task of
1e-3, limits of position and speed, none of acceleration. It was run once on the same commands; it is no dependency.
"""

from itertools import pairwise

import numpy as np
import pytest
from driving import CYCLE_S, PlainDrive, StackDrive, model

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.interface import Limit
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.driving import TELEOPERATION, DrivingMode
from deltaq_protocol.messages import Outcome
from studies.directions import DirectionGone, commands, drive, judged

JOINT, DECOUPLED, SELF_MOTION, _, COUPLED = TELEOPERATION
DURATION_S = 6.0

OFF_LINE_MM, OFF_LINE_DEG = 0.1, 0.01

PINK = {
    "fr": {
        "-x": (0.522, 0.039, 5.37),
        "+z": (0.395, 40.0, 15.4),
        "-z": (0.506, 63.7, 6.30),
        "+rx": (1.112, 106.3, 13.4),
    }
}
"""Where pink did not go all the way: the way [m or rad], and how far it was off its line [mm, deg]."""

DECOUPLED_BEFORE = {
    "dawm": {
        "-x": 0.106,
        "-z": 0.237,
        "+rx": 0.730,
        "-rx": 0.730,
        "-ry": 0.306,
        "-left.x": 0.106,
        "-left.z": 0.237,
    }
    | {"-left.rx": 0.730, "-left.ry": 0.306},
    "fr": {"-x": 0.493, "+z": 0.298, "-z": 0.435, "+rx": 0.643},
    "gr": {"-x": 0.398, "+z": 0.252, "-rx": 0.603, "+ry": 1.089, "-ry": 1.139},
}
"""The ways of decoupled mode before it was a programme, where it did not go all the way [m or rad]."""

SPEEDING_UP = 0.015
"""Part of a way of six seconds that speeding up may take: pink speeds up at once."""


def gone(robot: str, mode: DrivingMode, rates: dict[str, float]) -> DirectionGone:
    way, _, limited = drive(model(robot), mode, rates, DURATION_S, CYCLE_S)
    return judged(model(robot), rates, way, DURATION_S, limited)


def goes_as_far(robot: str, rates: dict[str, float]) -> None:
    found = gone(robot, COUPLED, rates)
    assert found.off_line_mm < OFF_LINE_MM, found
    assert found.off_line_deg < OFF_LINE_DEG, found
    ((_, rate),) = rates.items()
    whole = abs(rate) * DURATION_S
    before = DECOUPLED_BEFORE[robot].get(found.axis, whole)
    pink, off_mm, off_deg = PINK.get(robot, {}).get(found.axis, (whole, 0.0, 0.0))
    if off_mm > OFF_LINE_MM or off_deg > OFF_LINE_DEG:
        pink = 0.0  # it went on where the hand had left its line
    assert found.reached > max(before, pink) - SPEEDING_UP * whole, found


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(
    ("robot", "axis", "rate"),
    [("dawm", "x", 0.1), ("dawm", "ry", -0.2), ("gr", "z", 0.1), ("fr", "z", 0.1)],
)
def test_coupled_reaches_as_far_on_its_line_as_decoupled_and_pink(robot: str, axis: str, rate: float) -> None:
    goes_as_far(robot, {axis: rate})


@pytest.mark.nightly
@pytest.mark.parametrize("robot", ["fr", "dawm", "gr"])
def test_coupled_reaches_as_far_in_every_direction(robot: str) -> None:
    for rates in commands(model(robot)):
        goes_as_far(robot, rates)


@pytest.mark.long
@pytest.mark.parametrize(
    ("robot", "mode", "axis", "rate", "limit"),
    [
        ("dawm", DECOUPLED, "left.x", -0.1, Limit.JOINT_LIMIT),
        ("fr", COUPLED, "z", 0.1, Limit.WORKSPACE_EDGE),
        ("fr", COUPLED, "rx", 0.2, Limit.JOINT_LIMIT),
    ],
)
def test_at_a_limit_the_robot_stops_and_names_the_limit(
    robot: str, mode: DrivingMode, axis: str, rate: float, limit: Limit
) -> None:
    run = PlainDrive(robot, mode)
    run.drive(6.0, **{axis: rate})
    at_limit = run.drive(1.0, **{axis: rate})
    steps = np.array([now - before for before, now in pairwise(at_limit.q_cmd)])
    assert np.abs(steps).max() < 1e-6, "no chatter"
    assert set(at_limit.limitations) == {limit}
    assert run.violations == 0
    back = run.drive(1.0, **{axis: -rate})
    assert back.limitations[-1] == ""
    assert np.abs(run.dq_last).max() > 1e-4


def test_a_joint_at_its_limit_is_no_singularity() -> None:
    start = model("gr").home.copy()
    start[2] = model("gr").upper[2] - 1e-3  # e3
    run = PlainDrive("gr", COUPLED, start)
    driven = run.drive(2.0, z=0.1)
    assert set(driven.limitations) == {""}
    assert run.robot.forward(run.now)[2, 3] - run.robot.forward(start)[2, 3] > 0.18


@pytest.mark.long
@pytest.mark.nightly
def test_near_bodies_the_controller_stops_the_robot_before_the_gate_refuses() -> None:
    run = StackDrive("dawm", COUPLED, keeps_clear=True)
    driven = run.drive(5.5, **{"left.y": -0.15})
    assert {verdict.outcome for verdict in driven.verdicts} == {Outcome.ADMITTED}
    assert driven.limitations[-1] == Limit.CLEARANCE
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert "come no nearer: 30 mm" in limitation.text
    assert np.abs(driven.q_cmd[-1] - driven.q_cmd[-2]).max() < 1e-5
    away = run.drive(1.0, **{"left.y": 0.1})
    assert away.limitations[-1] == ""


@pytest.mark.nightly
@pytest.mark.parametrize("mode", [COUPLED, DECOUPLED])
def test_near_a_moving_robot_the_controller_stops_the_hand_before_the_gate_holds(
    mode: DrivingMode,
) -> None:
    run = StackDrive("gr", mode, keeps_clear=True)
    run.join("fr", DECOUPLED, y=-0.08)
    meeting = run.drive(5.6, y=0.12, x=0.04)
    run.join("fr", DECOUPLED, y=0.08)
    following = run.drive(1.5, y=0.12, x=0.04)
    for driven in (meeting, following):
        verdicts = driven.verdicts + driven.others_verdicts
        assert {verdict.outcome for verdict in verdicts} == {Outcome.ADMITTED}
    limitations = meeting.limitations
    assert Limit.CLEARANCE in limitations
    hand = [run.robot.forward(q)[1, 3] for q in meeting.q_cmd]
    assert hand[-1] - hand[-20] < 0.005, "it waits"
    assert run.robot.forward(following.q_cmd[-1])[1, 3] - hand[-1] > 0.05, (
        "it goes on as soon as the other one leaves"
    )


def test_motion_continues_from_the_scaled_increment() -> None:
    """The gate admits a part: the hand's line begins anew where it is, and nothing jumps."""
    run = PlainDrive("dawm", COUPLED)
    run.drive(1.0, z=0.1)
    before = run.now.copy()
    run.step_scaled(0.5, z=0.1)
    assert np.abs(run.now - before).max() > 0.0
    driven = run.drive(1.0, z=0.1)
    off = judged(run.robot, {"z": 0.1}, driven.q_cmd, 1.0)
    assert off.off_line_mm < OFF_LINE_MM
    assert run.violations == 0


@pytest.mark.parametrize("jerk_time_s", [0.05, 0.2])
def test_a_jerk_limit_is_kept_during_start_motion_and_stop_of_a_hand(jerk_time_s: float) -> None:
    run = PlainDrive("gr", COUPLED)
    run.teleoperator = Teleoperator(run.robot, CYCLE_S, COUPLED, jerk_time_s=jerk_time_s)
    q = [run.now] * 3 + run.drive(2.0, x=0.1).q_cmd + run.drive(2.0).q_cmd
    jerk = np.abs(np.diff(q, 3, axis=0)) / CYCLE_S**3
    assert (jerk <= run.robot.max_acceleration / jerk_time_s * (1.0 + 1e-6)).all()
    moved = judged(run.robot, {"x": 0.1}, q, 2.0)
    assert moved.reached > 0.16
    assert moved.off_line_mm < OFF_LINE_MM
    assert run.teleoperator.is_at_rest


def test_a_jerk_time_out_of_range_is_named_with_its_bounds() -> None:
    for wrong in (-0.1, 3.0, float("nan")):
        with pytest.raises(ControllerError, match=r"jerk time .* s: choose one from 0 to 1 s"):
            Teleoperator(model("gr"), CYCLE_S, jerk_time_s=wrong)


@pytest.mark.long
def test_a_drive_with_clearance_ends_near_bodies_with_a_reason() -> None:
    robot, cell = model("dawm"), CellModel.load("dawm")
    freely, _, _ = drive(robot, COUPLED, {"left.y": -0.2}, 4.0, CYCLE_S)
    clear, _, limited = drive(robot, COUPLED, {"left.y": -0.2}, 4.0, CYCLE_S, cell)
    ways = [judged(robot, {"left.y": -0.2}, way, 4.0).reached for way in (freely, clear)]
    assert ways[1] < ways[0] - 0.02
    assert "come no nearer" in limited
