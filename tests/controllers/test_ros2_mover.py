"""Trajectories of ROS in virtual time, through the real gate: kept to the path, however much is admitted."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_types import ATTACHMENT, encoded, point, trajectory
from small_cell import small_cell, tool_pose

from deltaq_cell.cell_model import robot_summary
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.ros2.messages import RefusedMessageError
from deltaq_controllers.ros2.mover import SHARE, RateProfile, TrajectoryFollower, TrajectoryMover
from deltaq_controllers.ros2.trajectory import Path, path_from, read_trajectory
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Phase, RobotState, Verdict
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.schedule import fault
from deltaq_testing.virtual import CellUnderTest

MOVED = np.array([0.3, -0.1, 0.15, 0.2, -0.2, 0.3])


class Driven:
    """A cell in virtual time whose robot a mover moves, with what it said and asked for."""

    def __init__(self, lab: Any, robot: str = "fr") -> None:
        self.cell = CellUnderTest(lab, robot)
        description = self.cell.model.description.robots[robot]
        self.summary = robot_summary(description, self.cell.cycle_s)
        self.said: list[tuple[str, dict[str, Any]]] = []
        self.mover = TrajectoryMover(
            robot,
            self.summary,
            self.cell.cycle_s,
            lambda text, fields: self.said.append((text, dict(fields))),
        )
        self.home = self.cell.q.copy()
        self.paths: list[Path] = []
        self._told = self.cell.note
        self.cell.note = self._note  # type: ignore[method-assign]  # the mover hears verdicts as in a live cell
        self.cell.drive(self._increment)

    def hear(self, *points: Any) -> None:
        message = trajectory(self.summary.joints if points else (), *points)
        self.mover.hear(encoded(message), ATTACHMENT, 0)

    def _note(self, message: Any) -> None:
        self._told(message)
        if isinstance(message, Verdict):
            self.mover.judged(message)

    def _increment(self, state: RobotState) -> Array:
        dq = self.mover.increment(state, View(RobotView.from_state(state)))
        follower: TrajectoryFollower | None = self.mover._driven
        if follower is not None and (not self.paths or self.paths[-1] is not follower.path):
            self.paths.append(follower.path)
        return dq

    @property
    def endings(self) -> list[str]:
        return [fields["ending"] for _, fields in self.said if fields["event"] == "ended"]

    def off_path(self) -> float:
        """The farthest that a setpoint was from all paths [rad], to the samples' spacing."""
        samples = np.concatenate([path.at(np.linspace(0, path.duration_s, 20_001)) for path in self.paths])
        setpoints = np.array(self.cell.history[self.cell.robot].setpoints)[self.cell.ready_row :: 4]
        return max(float(np.abs(samples - q).max(axis=1).min()) for q in setpoints)

    def kept(self) -> bool:
        return bool(self.cell.kept_clear()) and bool(self.cell.kept_limits())


@pytest.fixture(scope="module")
def lab() -> Any:
    return load_rsi_cell("lab")


@pytest.mark.long
def test_a_smooth_trajectory_is_driven_in_its_own_time_and_every_increment_is_admitted(lab: Any) -> None:
    driven = Driven(lab)
    middle, v = driven.home + MOVED, 0.5 * MOVED
    driven.hear(point(1.5, middle, v), point(3.0, middle + 0.5 * MOVED, 0.0 * v))
    driven.cell.run(3.6)  # the drives have followed by then
    assert driven.endings == ["arrived"]
    assert not driven.mover.has_work
    assert set(driven.cell.verdicts) == {"admitted"}
    np.testing.assert_allclose(driven.cell.q, driven.home + 1.5 * MOVED, atol=1e-6)
    assert driven.off_path() < 1e-4
    assert driven.kept()


@pytest.mark.long
def test_straight_segments_are_followed_and_slowed_down_at_corners(lab: Any) -> None:
    driven = Driven(lab)
    home, aside = driven.home, np.array([0.2, 0.0, 0.0, 0.0, 0.2, 0.0])
    # the third point goes back over the way that was come
    driven.hear(*(point(t, q) for t, q in ((0, home), (0.5, home + aside), (1.0, home), (1.5, home + MOVED))))
    driven.cell.run(1.5)
    assert driven.endings == []
    driven.cell.run(0.5)
    assert driven.endings == ["arrived"]
    assert set(driven.cell.verdicts) == {"admitted"}
    assert driven.off_path() < 1e-4


@pytest.mark.long
def test_a_closed_path_is_driven(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(0.5, driven.home + 0.3 * MOVED), point(1.0, driven.home))
    driven.cell.run(0.5)
    assert np.abs(driven.cell.q - driven.home).max() > 0.05
    driven.cell.run(1.2)
    assert driven.endings == ["arrived"]
    np.testing.assert_allclose(driven.cell.q, driven.home, atol=1e-6)


@pytest.mark.long
def test_missed_cycles_stretch_the_time_and_the_robot_returns_to_its_path(lab: Any) -> None:
    driven = Driven(lab)
    cut = fault("controller_hli_cut", at_s=0.4, for_s=0.12)
    driven.cell.suffer(cut, fault("hli_sim_lossy", at_s=0.8, for_s=0.5))
    driven.hear(point(0.7, driven.home + MOVED, MOVED), point(1.4, driven.home + 1.5 * MOVED, 0 * MOVED))
    driven.cell.run(3.0)
    assert driven.endings == ["arrived"]
    np.testing.assert_allclose(driven.cell.q, driven.home + 1.5 * MOVED, atol=1e-6)
    assert driven.off_path() < 5e-3
    assert driven.kept()


@pytest.mark.long
def test_an_empty_trajectory_brings_the_robot_to_rest_on_its_path(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(1.0)
    driven.hear()
    driven.cell.run(0.5)
    assert driven.endings == ["stopped"]
    rested = driven.cell.q.copy()
    assert 0.3 < ((rested - driven.home) / MOVED).min() < 0.8
    driven.cell.run(0.2)
    np.testing.assert_allclose(driven.cell.q, rested, atol=1e-9)
    assert driven.off_path() < 1e-4
    assert driven.mover.counters == {"trajectories": 1, "stops": 1, "ended_stopped": 1}


@pytest.mark.long
def test_a_new_trajectory_begins_where_the_robot_came_to_rest_on_the_old_one(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(0.8)
    driven.hear(point(1, driven.home - 0.3 * MOVED))
    driven.hear(point(1, driven.home - 0.5 * MOVED))
    driven.cell.run(2.0)
    assert driven.endings == ["stopped", "arrived"]
    assert len(driven.paths) == 2
    np.testing.assert_allclose(driven.cell.q, driven.home - 0.5 * MOVED, atol=1e-6)
    assert driven.off_path() < 1e-4


@pytest.mark.long
def test_a_stop_by_an_operator_ends_it_and_nothing_resumes_after_the_reset(lab: Any) -> None:
    driven = Driven(lab)
    driven.cell.suffer(fault("operator_stop", at_s=0.5))
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(1.0)
    assert driven.said[-1][0] == "fr: the trajectory has ended: the robot is held: operator_stop"
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(0.1)
    assert driven.endings == ["lost", "lost"]
    assert driven.cell.recover()
    rested = driven.cell.q.copy()
    driven.cell.run(0.5)
    np.testing.assert_allclose(driven.cell.q, rested, atol=1e-9)
    driven.hear(point(1, driven.home))
    driven.cell.run(1.2)
    assert driven.endings == ["lost", "lost", "arrived"]


@pytest.mark.long
def test_a_blocked_trajectory_slows_and_ends_with_the_gates_reason(lab: Any) -> None:
    driven = Driven(lab)
    down = driven.home.copy()
    down[1] = 0.5  # into the floor
    driven.hear(point(3, down))
    driven.cell.run(6.0)
    assert driven.endings == ["blocked"]
    assert "no progress was made for 2 s; the gate last said clearance fr/" in driven.said[-1][0]
    assert driven.cell.verdicts["scaled"] > 0
    assert driven.cell.verdicts["held"] > 100
    assert driven.kept()
    assert driven.off_path() < 1e-3


def test_a_trajectory_that_begins_elsewhere_is_refused_and_moves_nothing(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(0, driven.home + 0.1), point(1, driven.home))
    driven.mover.hear(b"\x00\x01\x00\x00", ATTACHMENT, 0)
    driven.mover.hear(encoded(trajectory(())), None, 0)
    driven.cell.run(0.2)
    assert driven.mover.counters == {
        "trajectories": 1, "refused": 3, "refused_malformed": 1, "refused_attachment": 1, "refused_start": 1,
    }  # fmt: skip
    last = "fr: a trajectory was refused: points[0].positions, a1, is 0.1 rad from the robot's setpoint"
    assert driven.said[-1][0].startswith(last)
    np.testing.assert_allclose(driven.cell.q, driven.home, atol=1e-6)


@pytest.mark.long
def test_a_gantry_is_moved_in_metres_and_radians(lab: Any) -> None:
    driven = Driven(lab, "gr")
    goal = driven.home + np.array([0.1, -0.05, 0.02, 0.1, 0, 0, 0, 0, 0.1])
    driven.hear(point(1.0, goal, np.zeros(9)))
    driven.cell.run(1.5)
    assert driven.endings == ["arrived"]
    np.testing.assert_allclose(driven.cell.q, goal, atol=1e-6)
    assert driven.off_path() < 1e-4


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_any_trajectory_within_the_limits_is_driven_on_its_path_with_every_increment_admitted(
    lab: Any, seed: int
) -> None:
    driven, rng = Driven(lab), np.random.default_rng(seed)
    count = int(rng.integers(2, 8))
    times_s = np.cumsum(rng.uniform(0.2, 0.8, count))
    q = driven.home + np.clip(np.cumsum(rng.uniform(-0.15, 0.15, (count, 6)), axis=0), -0.3, 0.3)
    v = rng.uniform(-0.3, 0.3, (count, 6)) * (np.arange(count) < count - 1)[:, None]
    has_velocities = rng.random(count) < (0.0, 0.5, 1.0)[seed % 3]
    driven.hear(
        *(point(t, a, b if has else ()) for t, a, b, has in zip(times_s, q, v, has_velocities, strict=True))
    )
    driven.cell.run(float(times_s[-1]) + 1.0)
    assert driven.endings == ["arrived"]
    assert set(driven.cell.verdicts) == {"admitted"}
    assert driven.off_path() < 1e-3
    assert driven.kept()


def test_a_robot_that_left_its_path_is_not_brought_back() -> None:
    cell = small_cell()
    arm = robot_summary(cell.robots["fr"], cell.cycle_s)
    said: list[str] = []
    mover = TrajectoryMover("fr", arm, cell.cycle_s, lambda text, _: said.append(text))
    mover.hear(encoded(trajectory(arm.joints, point(2, [0.5] * 6))), ATTACHMENT, 0)
    here, away = np.full(6, 0.1), np.array([0.1, 0.2, 0.1, 0.1, 0.1, 0.1])
    for cycle, q in enumerate((here, here, away, away)):
        dq = mover.increment(_state(cycle, q), View(RobotView(cycle, 0.0, q, q)))
    assert said[-1] == "fr: the trajectory has ended: the robot has left its path"
    assert not dq.any()


def test_a_trajectory_begins_only_when_the_robot_rests() -> None:
    cell = small_cell()
    arm = robot_summary(cell.robots["fr"], cell.cycle_s)
    said: list[str] = []
    mover = TrajectoryMover("fr", arm, cell.cycle_s, lambda text, _: said.append(text))
    mover.hear(encoded(trajectory(arm.joints, point(0, [0.1] * 6), point(1, [0.3] * 6))), ATTACHMENT, 0)
    for cycle, q in enumerate((0.3, 0.2, 0.1)):  # the brake of another client
        joints = np.full(6, q)
        assert not mover.increment(_state(cycle, joints), View(RobotView(cycle, 0.0, joints, joints))).any()
    assert mover.increment(_state(3, joints), View(RobotView(3, 0.0, joints, joints))).all()
    assert len(said) == 1


def _state(cycle: int, q: Array) -> RobotState:
    joints = tuple(q.tolist())
    return RobotState(
        robot="fr", cycle=cycle, ipoc=0, time_s=0.0, q=joints, q_cmd=joints, tool=tool_pose("fr", joints),
        phase=Phase.ENGAGED,
    )  # fmt: skip


# What is asked of a robot is checked against its joints and limits, and refused by field, value and bound.


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
            trajectory(A, point(1, q(), (), q(-INF))),
            "points[0].accelerations[0] is -inf, allowed is a finite number",
        ),
        (trajectory(A, point(1, q(), effort=(1.0,))), "points[0].effort is of length 1, allowed is 6"),
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
            trajectory(A, point(1, q()), stamp=(1_700_000_006, 0)),
            "header.stamp is +6.000 s from now, allowed is 0, or within 5 s of now",
        ),
        (trajectory(A, point(1, q()), stamp=(12, 0)), "header.stamp is -1699999988.000 s from now"),
        (trajectory(A, point(1, q()), stamp=(0, 10**9)), "header.stamp.nanosec is 1000000000, allowed is less than"),
        (trajectory(["a" * 300], point(1, q())), f"joint_names[0] is {'a' * 256!r}, allowed is a1, a2,"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_an_impossible_request_is_refused_with_field_value_and_bound(message, text):
    with pytest.raises(RefusedMessageError) as refused:
        read(message)
    assert str(refused.value).startswith(text)


def test_a_trajectory_without_points_is_a_stop_for_any_names():
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
def test_the_path_from_the_present_configuration_is_checked_too(points, text):
    asked = read(trajectory(A, *points))
    with pytest.raises(RefusedMessageError) as refused:
        path_from(asked, HERE, ARM)
    assert str(refused.value).startswith(text)


def test_a_near_first_point_is_approached_unless_already_reached():
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
def test_a_path_meets_its_points_and_its_extremes_agree_with_samples(rows):
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


def test_a_profile_slows_down_in_time_for_bends_and_corners():
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
