"""The closed forms of the Titan II and the KR 16: every branch, the singular poses, what is out of reach."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.models import load_urdf
from deltaq_controllers.inverse.branches import FREE, Branches, InverseError
from deltaq_controllers.inverse.kr16 import FOREARM_ANGLE, Kr16Inverse
from deltaq_controllers.inverse.titan import TitanInverse, TitanLengths
from deltaq_protocol.arrays import Array


def turns(axis: str, angle: Array) -> Array:
    """(N, 4, 4) turns about an axis."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T = np.broadcast_to(np.eye(4), (len(angle), 4, 4)).copy()
    T[:, i, i] = T[:, j, j] = np.cos(angle)
    T[:, i, j], T[:, j, i] = -np.sin(angle), np.sin(angle)
    return T


def shift(z: float) -> Array:
    T = np.eye(4)
    T[2, 3] = z
    return T


@dataclass
class Arm:
    """An arm joint by joint: before each joint a fixed placement, its axis with a sign, and after the last the tool."""

    solver: TitanInverse | Kr16Inverse
    placements: list[Array]
    axes: str
    signs: tuple[int, ...]
    end: Array

    def poses(self, q: Array) -> Array:
        """(N, 4, 4) poses of the tool at configurations (N, 6)."""
        T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        for joint, (axis, sign) in enumerate(zip(self.axes, self.signs, strict=True)):
            T = T @ self.placements[joint] @ turns(axis, sign * q[:, joint])
        end: Array = T @ self.end
        return end

    def pose(self, q: Array) -> Array:
        pose: Array = self.poses(q[None])[0]
        return pose

    def check(self, branches: Branches, wanted: Array) -> None:
        """Every branch that exists reaches its pose."""
        for branch in range(8):
            there = branches.exists[:, branch]
            reached = self.poses(branches.q[there, branch])
            assert np.abs(reached - wanted[there]).max(initial=0.0) < 1e-12


def titan_arm(lengths: TitanLengths) -> Arm:
    """As its drawing has it: six turns, and a length after each but the fifth."""
    places = [0.0, lengths.azimuth, lengths.upper_arm, lengths.forearm, lengths.wrist, 0.0]
    solver = TitanInverse(lengths)
    return Arm(solver, [shift(z) for z in places], "xyyyxz", (-1, 1, 1, 1, 1, 1), shift(lengths.tool))


model = pin.buildModelFromXML(load_urdf("kr16").text)
FLANGE = model.frames[model.getFrameId("flange")].placement.homogeneous
titan = titan_arm(TitanLengths())
kr16 = Arm(
    Kr16Inverse(),
    [model.jointPlacements[joint + 1].homogeneous for joint in range(6)],
    "zyyxyx",
    (-1, 1, 1, -1, 1, -1),
    FLANGE,
)
ARMS = {"titan": titan, "kr16": kr16}
NEAR = {  # an azimuth turned about needs reach behind the arm, so the wrist stays near
    "titan": np.array([0.3, 1.2, 2.0, -0.5, 0.4, 0.7]),
    "kr16": np.deg2rad([20, -100, 120, 30, 40, 50]),
}
LOWER = np.deg2rad([-120, -30, -135, -90, -90, -180])
UPPER = np.deg2rad([120, 90, 135, 90, 90, 180])


@pytest.fixture(params=ARMS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def difference(q: Array, other: Array) -> Array:
    """Greatest difference of a joint, by whole turns."""
    result: Array = np.abs(np.angle(np.exp(1j * (q - other)))).max(axis=-1)
    return result


def own(branches: Branches, q: Array) -> Array:
    """How far the nearest branch is from the configuration that the pose came from."""
    apart = difference(branches.q, q[..., None, :])
    nearest: Array = np.where(branches.exists, apart, np.inf).min(axis=-1)
    return nearest


def test_the_chain_of_the_kr16_places_its_flange_as_the_model_does() -> None:
    data = model.createData()
    for q in np.random.default_rng(1).uniform(-np.pi, np.pi, (50, 6)):
        pin.forwardKinematics(model, data, q)
        flange = pin.updateFramePlacement(model, data, model.getFrameId("flange")).homogeneous
        assert np.abs(kr16.pose(q) - flange).max() < 1e-14


@pytest.mark.long
def test_the_branches_contain_the_original_configuration(name: str) -> None:
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (100_000, 6))
    branches = ARMS[name].solver.inverse(ARMS[name].poses(q))
    # a joint is no better known than the distance to the nearest singularity lets it
    assert own(branches, q).max() < 1e-6


def test_a_pose_well_inside_the_workspace_has_eight_different_solutions(name: str) -> None:
    branches = ARMS[name].solver.inverse(ARMS[name].pose(NEAR[name]))
    assert branches.exists.all()
    for first in range(8):
        for second in range(first):
            assert difference(branches.q[first], branches.q[second]) > 0.1


def test_the_branches_of_the_kr16_have_the_documented_order() -> None:
    branches = kr16.solver.inverse(kr16.pose(NEAR["kr16"]))
    assert np.all(np.cos(branches.q[:4, 0] - np.deg2rad(20)) > 0)
    assert np.all(np.cos(branches.q[4:, 0] - np.deg2rad(20)) < 0)
    elbow = np.sin(branches.q[:, 2] + FOREARM_ANGLE)
    assert np.all(elbow[[0, 1, 4, 5]] >= 0)
    assert np.all(elbow[[2, 3, 6, 7]] <= 0)
    assert np.all(branches.q[0::2, 4] >= 0)
    assert np.all(branches.q[1::2, 4] <= 0)


def test_every_pose_with_a_solution_inside_the_limits_is_solved() -> None:
    q = np.random.default_rng(4).uniform(LOWER, UPPER, (20_000, 6))
    nearest = titan.solver.inverse(titan.poses(q)).nearest(np.zeros(6), LOWER, UPPER)
    assert np.isfinite(nearest).all()
    assert np.all((nearest >= LOWER) & (nearest <= UPPER))


def test_a_pose_out_of_reach_is_reported_without_clipping(name: str) -> None:
    pose = np.eye(4)
    # a Titan stretched out reaches 1.92 m
    pose[:3, 3] = (0.0, 0.0, 1.93) if name == "titan" else (2.0, 0.0, 0.0)
    branches = ARMS[name].solver.inverse(pose)
    assert not branches.exists.any()
    assert np.isnan(branches.q).all()


def test_a_pose_too_near_to_the_shoulder_is_out_of_reach() -> None:
    pose = titan.pose(np.array([0.0, 0.5, np.pi, 0.0, 0.0, 0.0]))
    wrist = pose[:3, 3] - 0.31 * pose[:3, 2] - 0.17 * pose[:3, 2]
    shoulder = np.array([0.0, 0.0, 0.12])
    pose[:3, 3] -= 0.05 * (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    assert not titan.solver.inverse(pose).exists[:2].any()


# where the wrist is on the axis of the first joint:
# of the Titan, rho = L1 + L2 cos t2 + L3 cos(t2 + t3) + L4 cos(Phi) = 0
T3 = np.arccos(-(0.12 + 0.84 * np.cos(1.4) + 0.17 * np.cos(0.4)) / 0.48) - 1.4
# of the KR 16, 0.26 + 0.68 cos A2 + L cos(A2 + A3 + psi) = 0
A2 = np.deg2rad(-110)
A3 = -np.arccos(-(0.26 + 0.68 * np.cos(A2)) / np.hypot(0.67, 0.035)) - A2 - FOREARM_ANGLE


@pytest.mark.parametrize(
    ("arm", "q", "free", "exact"),
    [
        (titan, [0.5, 0.7, 0.9, -0.6, np.pi / 2, 0.8], "t2+t3+t4", 1e-12),
        (titan, [0.5, 0.7, 0.9, -0.6, -np.pi / 2, 0.8], "t2+t3+t4", 1e-12),
        # the hint counts for its own azimuth
        (titan, [0.5 - np.pi, 2.6, 1.2, -0.9, np.pi / 2, 0.8], "t2+t3+t4", 1e-12),
        (titan, [0.9, 1.4, T3, 0.4 - 1.4 - T3, 0.3, 0.5], "t1", 1e-9),
        (kr16, np.deg2rad([20.0, -60, 70, 33, 0, -50]), "a4", 1e-12),
        (kr16, [0.7, A2, A3, 0.3, 0.6, 0.2], "a1", 1e-9),
    ],
    ids=["square wrist", "square wrist back", "own azimuth", "on the azimuth axis", "straight wrist", "over the base"],
)  # fmt: skip
def test_a_joint_that_a_pose_leaves_free_follows_the_hint(
    arm: Arm, q: Array, free: str, exact: float
) -> None:
    q = np.asarray(q)
    pose = arm.pose(q)
    branches = arm.solver.inverse(pose, hint=q)
    assert [name for name, is_free in branches.free.items() if is_free] == [free]
    assert own(branches, q) < exact
    assert np.abs(arm.poses(branches.q[branches.exists]) - pose).max() < 1e-12


@pytest.mark.parametrize("distance", [1e-15, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-7, 1e-5])
def test_near_singularities_the_round_trip_stays_exact(name: str, distance: float) -> None:
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (2000, 6))
    if name == "titan":
        q[:1000, 4] = np.pi / 2 - distance  # both at once has no solution that double precision could tell
        q[1000:, 2] = distance
    else:
        q[:, 4] = distance
    wanted = ARMS[name].poses(q)
    branches = ARMS[name].solver.inverse(wanted)
    ARMS[name].check(branches, wanted)
    if name == "titan":
        # where the pitch is free, that of the hint need not reach
        assert (branches.exists.any(axis=1) | branches.free["t2+t3+t4"]).all()
        assert distance == FREE or branches.free["t2+t3+t4"].any() == (distance < FREE)


@pytest.mark.parametrize("kind", [TitanInverse, Kr16Inverse])
def test_the_tool_transform_is_removed_before_solving(kind: type[TitanInverse | Kr16Inverse]) -> None:
    arm = titan if kind is TitanInverse else kr16
    T_end_tool = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 0.8), np.array([0.02, -0.05, 0.28])).homogeneous
    q = np.random.default_rng(6).uniform(-np.pi, np.pi, (500, 6))
    solver = TitanInverse(T_hand_tool=T_end_tool) if kind is TitanInverse else Kr16Inverse(T_end_tool)
    with_tool = Arm(solver, arm.placements, arm.axes, arm.signs, arm.end @ T_end_tool)
    wanted = with_tool.poses(q)
    branches = solver.inverse(wanted)
    with_tool.check(branches, wanted)
    assert own(branches, q).max() < 1e-6


def test_other_lengths_are_other_arms() -> None:
    arm = titan_arm(TitanLengths(azimuth=0.1, upper_arm=0.5, forearm=0.5, wrist=0.1, tool=0.0))
    wanted = arm.poses(np.random.default_rng(7).uniform(-np.pi, np.pi, (2000, 6)))
    branches = arm.solver.inverse(wanted)
    assert branches.exists.any(axis=1).all()
    arm.check(branches, wanted)


def test_a_single_pose_gives_the_same_as_a_batch(name: str) -> None:
    poses = ARMS[name].poses(np.random.default_rng(8).uniform(-1, 1, (3, 6)))
    many, one = ARMS[name].solver.inverse(poses), ARMS[name].solver.inverse(poses[1])
    assert one.q.shape == (8, 6)
    assert np.array_equal(one.q, many.q[1], equal_nan=True)


def test_solutions_are_fitted_to_limits_by_whole_turns() -> None:
    q = np.array([0.2, 0.4, 0.5, -0.3, 0.2, 3.0])
    branches = titan.solver.inverse(titan.pose(q))
    wide = np.deg2rad([-350.0] * 6)
    fitted, inside = branches.fitted(q - 2 * np.pi * np.eye(6)[5], wide, -wide)
    assert inside[np.nanargmin(difference(branches.q, q))]
    assert np.abs(fitted[inside] - (q - 2 * np.pi * np.eye(6)[5])).max(axis=1).min() < 1e-12


def test_an_invalid_pose_or_hint_is_refused(name: str) -> None:
    solver = ARMS[name].solver
    for poses in (np.eye(3), np.zeros((2, 3, 4)), np.zeros((2, 2, 4, 4))):
        with pytest.raises(InverseError, match=r"\(4, 4\) or \(N, 4, 4\)"):
            solver.inverse(poses)
    with pytest.raises(InverseError, match="six finite joint angles"):
        solver.inverse(np.eye(4), hint=np.zeros(7))
    with np.errstate(invalid="ignore"):
        assert not solver.inverse(np.full((4, 4), np.nan)).exists.any()
