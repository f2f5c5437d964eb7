"""The inverse of arms that nobody wrote one for, against pinocchio's own forward kinematics."""

import sys

import numpy as np
import published_arms
import pytest
import seven_axes
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from ran import ran

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import RobotDescription
from deltaq_cell.robot import RobotModel
from deltaq_controllers.inverse.any_arm import AnyArm
from deltaq_controllers.inverse.branches import InverseError, wrapped
from deltaq_controllers.inverse.chain import Chain, chain_of
from deltaq_controllers.inverse.tracking import ConstraintTracker, TrackingError

CELL, LAB, DAWM = published_arms.cell(), CellModel.load("lab"), CellModel.load("dawm")
ROBOTS = {"ur": CELL.robots["ur"], "panda": CELL.robots["panda"], "kr16": LAB.robots["fr"]}


class Case:
    """One robot's arm, by one of the two roads, and an oracle: pinocchio's forward kinematics of the robot."""

    def __init__(self, name: str, road: str) -> None:
        self.robot, self.is_numeric = ROBOTS[name], road == "numeric"
        # the joint beyond a Panda's arm stays at zero, so that the arm is six joints in a row
        joints = np.arange(6)
        self.lower, self.upper = self.robot.lower[joints], self.robot.upper[joints]
        chain = _chain(self.robot)
        self.arm = AnyArm(chain, self.lower, self.upper, numeric=self.is_numeric)
        self.T_base_world = np.linalg.inv(_base(self.robot))

    def pose(self, q: np.ndarray) -> np.ndarray:
        world = self.robot.forward(np.append(q, np.zeros(self.robot.n - 6)))
        return self.T_base_world @ world

    def check(self, q: np.ndarray, wanted: np.ndarray, exact: float = 1e-9) -> None:
        assert np.abs(self.pose(q) - wanted).max() < exact


def _base(robot: RobotModel) -> np.ndarray:
    """The first joint's frame at zero, in the world."""
    return robot.model.jointPlacements[1].homogeneous


def _chain(robot: RobotModel) -> Chain:
    T_last_tool = robot.model.frames[robot.frame_of("tool")].placement.homogeneous
    if robot.n == 7:
        T_last_tool = robot.model.jointPlacements[7].homogeneous @ T_last_tool
    return chain_of(robot.model, np.arange(6), T_last_tool)


CASES = [(name, road) for name in ROBOTS for road in ("closed form", "numeric")]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: " ".join(case))
def case(request: pytest.FixtureRequest) -> Case:
    return Case(*request.param)


def test_the_closed_form_knows_both_kinds_of_arm() -> None:
    families = [Case(name, "closed form").arm.family for name in ("ur", "panda", "kr16")]
    assert "THREE_INNER_PARALLEL" in families[0]
    assert "SPHERICAL" in families[1]
    assert "SPHERICAL" in families[2]


def test_every_branch_reaches_its_pose_and_the_configuration_itself_is_one(case: Case) -> None:
    random = np.random.default_rng(1)
    q = random.uniform(case.lower, case.upper, (60 if case.is_numeric else 400, 6))
    wanted = np.stack([case.pose(row) for row in q])
    branches = case.arm.inverse(wanted)
    for row, branch in np.argwhere(branches.exists):
        case.check(branches.q[row, branch], wanted[row], 1e-11)
    off = np.where(branches.exists, np.abs(wrapped(branches.q - q[:, None])).max(axis=2), np.inf)
    # Newton's method from 48 starts misses a branch now and then
    assert (off.min(axis=1) < 1e-7).mean() >= (0.95 if case.is_numeric else 1.0)
    assert np.isnan(branches.q[~branches.exists]).all()
    assert np.all(np.abs(branches.q[branches.exists]) <= np.pi)


def test_no_branch_comes_twice(case: Case) -> None:
    random = np.random.default_rng(2)
    for q in random.uniform(case.lower, case.upper, (10, 6)):
        branches = case.arm.inverse(case.pose(q))
        found = branches.q[branches.exists]
        for row in range(len(found)):
            apart = np.abs(wrapped(found[row + 1 :] - found[row])).max(axis=1, initial=0.0)
            assert np.all(apart > 1e-6)


def test_closed_form_and_newton_find_the_same_branches() -> None:
    closed, numeric = Case("ur", "closed form"), Case("ur", "numeric")
    random = np.random.default_rng(3)
    found = missed = 0
    for q in random.uniform(closed.lower, closed.upper, (40, 6)):
        known = closed.arm.inverse(closed.pose(q))
        tried = numeric.arm.inverse(closed.pose(q))
        for one in known.q[known.exists]:
            apart = np.abs(wrapped(tried.q[tried.exists] - one)).max(axis=1)
            found += 1
            missed += not (apart < 1e-6).any()
        assert tried.exists.sum() <= known.exists.sum()
    assert missed < 0.1 * found


@given(
    q=arrays(np.float64, 6, elements=st.floats(-3.1, 3.1)),
    singular=st.lists(st.sampled_from(range(6)), max_size=6),
)
@settings(max_examples=40, deadline=None)
@pytest.mark.parametrize("name", ["ur", "panda"])
def test_solutions_are_valid_or_missing_also_in_singularities(
    name: str, q: np.ndarray, singular: list[int]
) -> None:
    case = _cached(name)
    q[singular] = 0.0  # elbow stretched, wrist folded, and whatever else is singular there
    branches = case.arm.inverse(case.pose(q), hint=q)
    assert branches.exists.any()
    for found in branches.q[branches.exists]:
        case.check(found, case.pose(q))
    # the hint gives what the pose leaves free; where joints touch without being free, they count by their square
    assert np.abs(wrapped(branches.q[branches.exists] - q)).max(axis=1).min() < 1e-4


_KNOWN: dict[str, Case] = {}


def _cached(name: str) -> Case:
    return _KNOWN.setdefault(name, Case(name, "closed form"))


def test_an_unreachable_or_invalid_pose_is_reported_and_stops_nothing_else(case: Case) -> None:
    good = case.pose(0.5 * (case.lower + case.upper) + 0.3)
    bad = np.stack([good] * 6)
    bad[1, 0, 3] = np.nan
    bad[2, :3, 3] += 1e300
    bad[3, :3, 3] += 1.9
    bad[4] = np.inf
    branches = case.arm.inverse(bad)
    assert branches.exists.any(axis=1).tolist() == [True, False, False, False, False, True]
    near = case.arm.near(bad, np.zeros((6, 6)), np.full(6, -np.pi), np.full(6, np.pi))
    assert np.isfinite(near).all(axis=1).tolist() == [True, False, False, False, False, True]
    way = case.arm.follow(bad[None], np.array(branches.q[0, 0])[None])
    assert np.isfinite(way[0]).all(axis=1).tolist() == [True] + 5 * [False]
    with pytest.raises(InverseError, match="homogeneous"):
        case.arm.inverse(np.zeros((3, 3)))
    with pytest.raises(InverseError, match="hint"):
        case.arm.inverse(good, hint=np.full(6, np.nan))


def test_no_pose_at_all_has_no_solution(case: Case) -> None:
    assert case.arm.inverse(np.empty((0, 4, 4))).q.shape[0] == 0
    assert case.arm.near(np.empty((0, 4, 4)), np.empty((0, 6)), case.lower, case.upper).shape == (0, 6)


def test_near_a_reference_the_nearest_solution_is_its_continuation(case: Case) -> None:
    random = np.random.default_rng(4)
    q = random.uniform(case.lower + 0.1, case.upper - 0.1, (50, 6))
    moved = q + random.normal(0.0, 0.005, q.shape)
    wanted = np.stack([case.pose(row) for row in moved])
    near = case.arm.near(wanted, q, case.lower, case.upper)
    for row, pose in zip(near, wanted, strict=True):
        case.check(row, pose, 1e-11)
    assert (np.abs(near - moved).max(axis=1) < 1e-6).mean() > 0.9


def test_a_path_is_followed_to_a_fold_and_not_beyond(case: Case) -> None:
    start = 0.5 * (case.lower + case.upper) + 0.3
    end = start.copy()
    end[2] += 0.4
    there = np.stack([case.pose(start + share * (end - start)) for share in np.linspace(0.0, 1.0, 30)])
    (way,) = case.arm.follow(there[None], start[None])
    np.testing.assert_allclose(way[-1], end, atol=1e-8)
    away = np.stack([there[0]] * 60)
    away[:, :3, 3] += np.linspace(0.0, 4.0, 60)[:, None] * away[0, :3, 3] / np.linalg.norm(away[0, :3, 3])
    (way,) = case.arm.follow(away[None], start[None])
    reached = np.isfinite(way).all(axis=1)
    assert reached[0]
    assert not reached[-1]
    last = int(np.argmin(reached))
    assert not reached[last:].any()
    for row, pose in zip(way[:last], away, strict=False):
        case.check(row, pose)
    # no jump to another branch on the way
    assert np.abs(np.diff(way[:last], axis=0)).max(initial=0.0) < 1.5


@pytest.mark.parametrize("name", ["ur", "panda"])
def test_the_branch_changes_in_singularities_only(name: str) -> None:
    arm, case = _cached(name).arm, _cached(name)
    q = 0.5 * (case.lower + case.upper) + 0.3
    signs = set()
    for found in (branches := arm.inverse(case.pose(q))).q[branches.exists]:
        signs.add(arm.branch(case.pose(q), found))
        assert arm.branch(case.pose(q), found) == arm.branch(case.pose(q), found + 1e-6)
    assert signs == {0, 1}


@pytest.mark.parametrize(("name", "free"), [("ur", []), ("panda", ["panda_joint7"])])
def test_a_robot_is_split_into_its_arm_and_the_joints_that_are_free(name: str, free: list[str]) -> None:
    robot = ROBOTS[name]
    tracker = ConstraintTracker(robot)
    assert [robot.joint_names[joint] for joint in tracker.base] == free
    for q in np.random.default_rng(5).uniform(robot.lower, robot.upper, (50, robot.n)):
        poses = tracker.hands(q)
        (found,) = tracker.track(q[None, tracker.base], poses, q)
        np.testing.assert_allclose(tracker.hands(found), poses, atol=1e-10)
        np.testing.assert_allclose(found, q, atol=1e-4)


def test_the_self_motion_of_a_panda_keeps_its_hand() -> None:
    robot = ROBOTS["panda"]
    tracker = ConstraintTracker(robot)
    poses, home = tracker.hands(robot.home), robot.home
    (way,) = tracker.walk(home[None], home[tracker.base][None] + 0.5, poses, 20)
    assert np.isfinite(way).all()
    for q in way:
        assert np.abs(tracker.hands(q) - poses).max() < 1e-10
    assert np.abs(np.diff(way, axis=0)).max() < 0.2
    assert tracker.branch(way[0], poses) == tracker.branch(way[-1], poses)


def test_the_arms_of_the_shipped_robots_keep_their_own_closed_forms() -> None:
    kinds = {
        name: type(ConstraintTracker(robot).arms[0].solver).__name__
        for name, robot in (
            ("gr", LAB.robots["gr"]),
            ("fr", LAB.robots["fr"]),
            ("dawm", DAWM.robots["dawm"]),
        )
    }
    assert kinds == {"gr": "Kr16Inverse", "fr": "Kr16Inverse", "dawm": "TitanInverse"}


@pytest.mark.nightly
def test_without_the_extra_another_arm_is_solved_numerically_and_the_same_poses_are_reached() -> None:
    code = """
import sys
sys.modules["eaik"] = sys.modules["scipy"] = None
import numpy as np, published_arms
from deltaq_controllers.inverse.chain import Chain, chain_of
from deltaq_controllers.inverse.tracking import ConstraintTracker
for name, robot in published_arms.cell().robots.items():
    tracker = ConstraintTracker(robot)
    (arm,) = tracker.arms
    assert arm.solver.family == ""
    poses = tracker.hands(robot.home)
    (q,) = tracker.track(robot.home[None, tracker.base], poses, robot.home)
    assert np.abs(tracker.hands(q) - poses).max() < 1e-10
    assert np.abs(q - robot.home).max() < 1e-6
    print(name, [robot.joint_names[joint] for joint in tracker.base], tracker.word)
"""
    done = ran([sys.executable, "-c", f"import sys; sys.path[:0] = {sys.path!r}\n{code}"])
    ur, panda = done.stdout.splitlines()
    assert ur.startswith("ur [] the arm of tool has no closed form here and is solved numerically")
    assert panda.startswith("panda ['panda_joint1'] ")
    assert "pip install 'deltaq[arms]'" in ur


def test_a_chain_that_is_too_short_or_slides_is_refused_by_name() -> None:
    urdf = seven_axes.urdf()
    whole = seven_axes.cell().robots["fr"].description.model_dump(exclude={"camera"}, exclude_none=True)
    slide = {
        "home_m": 0,
        "lower_m": -0.2,
        "upper_m": 0.2,
        "max_velocity_m_s": 1,
        "max_acceleration_m_s2": 1,
    }
    sliding = RobotDescription.model_validate(whole | {"joints": whole["joints"] | {"j5": slide}})
    changed = urdf.replace('<joint name="j5" type="revolute">', '<joint name="j5" type="prismatic">')
    with pytest.raises(TrackingError, match="j5 is prismatic; the six joints before tool must be revolute"):
        ConstraintTracker(RobotModel(sliding, "fr", changed))
    locked = RobotDescription.model_validate(
        whole
        | {
            "joints": {name: joint for name, joint in whole["joints"].items() if name not in ("j1", "j2")},
            "locked_joints": {"j1": 0.0, "j2": 0.0},
        }
    )
    with pytest.raises(TrackingError, match="tool is carried by 5 joints, and an arm has 6"):
        ConstraintTracker(RobotModel(locked, "fr", urdf))
