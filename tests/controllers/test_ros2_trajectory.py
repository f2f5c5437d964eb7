"""What is asked of a robot is checked against its joints and limits, and refused by field, value and bound."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_points import point, trajectory
from small_cell import small_cell

from deltaq_cell.cell_model import robot_summary
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.ros2.messages import Header, RefusedMessageError, RosTime
from deltaq_controllers.ros2.mover import SHARE, RateProfile
from deltaq_controllers.ros2.trajectory import Path, path_from, read_trajectory

CELL = small_cell()
GANTRY = robot_summary(CELL.robots["gr"], CELL.cycle_s)
ARM = robot_summary(CELL.robots["fr"], CELL.cycle_s)
A = ARM.joints
HERE = np.full(6, 0.1)
NOW_NS = 1_700_000_000 * 10**9
NAN, INF = float("nan"), float("inf")


def q(value=0.1, at=None):
    """Where the arm is, or with its first joint elsewhere."""
    return (value if at is None else at, 0.1, 0.1, 0.1, 0.1, 0.1)


def v(at):
    """Speeds of the arm whose first joint moves."""
    return (at, 0.0, 0.0, 0.0, 0.0, 0.0)


def read(message, robot=ARM):
    return read_trajectory(message, robot, NOW_NS)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (trajectory((*A[:5], "a7"), point(1, q())), "joint_names[5] is 'a7', allowed is a1, a2, a3, a4, a5, a6"),
        (trajectory((*A[:5], "a1"), point(1, q())), "joint_names[5] is 'a1' again, allowed is each joint once"),
        (trajectory(A[:4], point(1, q())), "joint_names is without a5, a6, allowed is all of a1, a2,"),
        (trajectory((), point(1, ())), "joint_names is without a1, a2"),
        (trajectory(A, point(1, q()[:5])), "points[0].positions is of length 5, allowed is 6, one for each joint"),
        (trajectory(A, point(1, ())), "points[0].positions is of length 0, allowed is 6"),
        (trajectory(A, point(1, q(), (0, 0))), "points[0].velocities is of length 2, allowed is 6, one for each"),
        (trajectory(A, point(1, q(NAN))), "points[0].positions[0] is nan, allowed is a finite number"),
        (trajectory(A, point(1, q(), q(INF))), "points[0].velocities[0] is inf, allowed is a finite number"),
        (
            trajectory(A, replace(point(1, q()), accelerations=q(-INF))),
            "points[0].accelerations[0] is -inf, allowed is a finite number",
        ),
        (trajectory(A, replace(point(1, q()), effort=(1.0,))), "points[0].effort is of length 1, allowed is 6"),
        (trajectory(A, point(-1, q())), "points[0].time_from_start is -1 s, allowed is 0 to 600 s"),
        (trajectory(A, point(600.5, q())), "points[0].time_from_start is 600.5 s, allowed is 0 to 600 s"),
        (
            trajectory(A, point(2, q()), point(1, q())),
            "points[1].time_from_start is 1 s, allowed is more than the 2 s of the point before",
        ),
        (
            trajectory(A, point(1, q()), point(1, q())),
            "points[1].time_from_start is 1 s, allowed is more than the 1 s of the point before",
        ),
        (trajectory(A, point(9, q(3.0))), "points[0].positions, a1, is 3 rad, allowed is -2.96706 to 2.96706 rad"),
        (
            trajectory(A, point(1, q(), v(0.5))),
            "points[0].velocities, a1, is 0.5 rad/s, allowed is rest at the end, 0.0015708 rad/s or less",
        ),
        (
            trajectory(A, point(1, q()), header=Header(RosTime(1_700_000_006))),
            "header.stamp is +6.000 s from now, allowed is 0, or within 5 s of now",
        ),
        (trajectory(A, point(1, q()), header=Header(RosTime(12))), "header.stamp is -1699999988.000 s from now"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_what_a_robot_cannot_be_asked_is_refused_by_field_value_and_bound(message, text):
    with pytest.raises(RefusedMessageError) as refused:
        read(message)
    assert str(refused.value).startswith(text)


def test_no_points_are_a_stop_whatever_the_names():
    assert read(trajectory(())) is None
    assert read(trajectory(("a1", "a1"))) is None


def test_joints_may_come_in_any_order_and_a_gantry_has_its_units():
    names = tuple(reversed(GANTRY.joints))
    asked = read(trajectory(names, point(1, [0.1] * 6 + [0.9, 0.8, 0.7])), GANTRY)
    assert asked.q[0].tolist() == [0.7, 0.8, 0.9] + [0.1] * 6
    with pytest.raises(RefusedMessageError, match=r"e1, is 1\.6 m, allowed is 0 to 1\.5 m"):
        read(trajectory(names, point(1, [0.1] * 8 + [1.6])), GANTRY)


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (
            (point(0, q(at=0.15)), point(1, q())),
            "points[0].positions, a1, is 0.05 rad from the robot's setpoint, allowed is 0.02 rad or less at time_from",
        ),
        (
            (point(1, q(at=2.0)),),
            "the speed towards points[0], a1, is 1.9 rad/s, allowed is 1.5708 rad/s or less",
        ),
        (
            (point(0, q()), point(1, q()), point(1.1, q(at=0.3))),
            "the speed towards points[2], a1, is 2 rad/s, allowed is 1.5708 rad/s or less",
        ),
        (  # within the limits at its ends, a cubic is beyond them between them
            (point(4, q(at=2.9), v(1.2)), point(6, q(at=2.9), v(0.0))),
            "the way to points[1], a1, is at 3.256 rad, allowed is -2.96706 to 2.96706 rad",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_leads_from_where_the_robot_is_is_checked_too(points, text):
    asked = read(trajectory(A, *points))
    with pytest.raises(RefusedMessageError) as refused:
        path_from(asked, HERE, ARM)
    assert str(refused.value).startswith(text)


def test_a_first_point_nearby_is_approached_and_one_that_is_met_is_not():
    asked = read(trajectory(A, point(0, q(at=0.115)), point(1, q(at=0.5))))
    path = path_from(asked, HERE, ARM)
    assert path.at(np.array([0.0]))[0].tolist() == HERE.tolist()
    approach_s = 0.015 / (0.5 * ARM.max_velocity[0])
    np.testing.assert_allclose(path.times_s, [0.0, approach_s, approach_s + 1.0])
    met = path_from(read(trajectory(A, point(0, q()), point(1, q(at=0.5)))), HERE, ARM)
    assert met.times_s.tolist() == [0.0, 1.0]


numbers = st.floats(-2, 2)


@pytest.mark.long
@given(st.lists(st.tuples(st.floats(0.05, 2), numbers, numbers, st.booleans()), min_size=2, max_size=6))
def test_a_path_passes_its_points_as_they_say_and_its_extremes_are_those_of_its_samples(rows):
    times_s = np.cumsum([row[0] for row in rows]) - rows[0][0]
    q = np.array([[row[1]] for row in rows])
    v = np.array([[row[2] if row[3] else NAN] for row in rows])
    path = Path(times_s, q, v)
    np.testing.assert_allclose(path.at(times_s), q, atol=1e-9)
    for k in range(len(rows) - 1):
        inside = np.linspace(times_s[k], times_s[k + 1], 403)[1:-1]
        least, greatest, fastest = (extreme[k, 0] for extreme in path.extremes())
        sampled, speeds = path.at(inside), np.abs(path.velocity(inside))
        if rows[k][3] and rows[k + 1][3]:
            ends = times_s[[k, k + 1]] + [1e-6 * rows[k + 1][0], -1e-6 * rows[k + 1][0]]
            given_there = v[k : k + 2, 0]
            np.testing.assert_allclose(path.velocity(ends)[:, 0], given_there, atol=1e-3 * (1 + fastest))
        else:
            np.testing.assert_allclose(speeds, abs(q[k + 1, 0] - q[k, 0]) / rows[k + 1][0], atol=1e-9)
        assert least - 1e-9 <= sampled.min()
        assert sampled.max() <= greatest + 1e-9
        assert speeds.max() <= fastest * (1 + 1e-9) + 1e-9
        np.testing.assert_allclose([sampled.min(), sampled.max()], [least, greatest], atol=0.05)
        differences = (sampled[2:, 0] - sampled[:-2, 0]) / (inside[2:] - inside[:-2])
        np.testing.assert_allclose(differences, path.velocity(inside)[1:-1, 0], atol=1e-3 * (1 + fastest))


def test_a_profile_slows_down_for_bends_and_corners_and_in_time_for_them():
    limits = IncrementLimits.told(ARM, CELL.cycle_s)
    nothing = np.full((3, 6), NAN)
    corner = Path(np.array([0.0, 1.0, 2.0]), np.array([q(at=0.0), q(at=1.0), q(at=0.0)]), nothing)
    rate = RateProfile(corner, limits, CELL.cycle_s).rate
    jump = 2.0 * rate(np.array([1.0]))[0]
    np.testing.assert_allclose(jump / (CELL.cycle_s * ARM.max_acceleration[0]), SHARE, rtol=1e-5)
    assert rate(np.array([0.5]))[0] == 1.0
    before_s = np.linspace(0.5, 1.0, 200)
    falls = -np.diff(rate(before_s) ** 2) / np.diff(before_s) / 2.0
    assert 0.8 * ARM.max_acceleration[0] < falls.max() < ARM.max_acceleration[0]
    ends = np.array([q(at=0.0), q(at=1.0)])
    bent = Path(np.array([0.0, 0.5]), ends, np.zeros((2, 6)))  # starts with 24 rad/s^2, the arm has 4
    begin = RateProfile(bent, limits, CELL.cycle_s).rate(np.array([0.0]))[0]
    np.testing.assert_allclose(begin**2 * 24.0, SHARE * ARM.max_acceleration[0], rtol=0.02)
