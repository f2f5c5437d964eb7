"""The closed form of the Schilling Titan II: every branch, the singular poses, what is out of reach."""

from __future__ import annotations

import numpy as np
import pytest

from deltaq_controllers.inverse.branches import InverseError
from deltaq_controllers.inverse.titan import TitanInverse, TitanLengths
from deltaq_protocol.arrays import Array

titan = TitanInverse()
LOWER = np.deg2rad([-120, -30, -135, -90, -90, -180])
UPPER = np.deg2rad([120, 90, 135, 90, 90, 180])


def turn(axis: str, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(4)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def shift(z: float) -> Array:
    T = np.eye(4)
    T[2, 3] = z
    return T


def chain(q: Array) -> Array:
    """The arm joint by joint, as its drawing has it: six turns, and a length after each but the fifth."""
    t1, t2, t3, t4, t5, t6 = q
    upper_arm = turn("x", -t1) @ shift(0.12) @ turn("y", t2) @ shift(0.84)
    return (
        upper_arm
        @ (turn("y", t3) @ shift(0.48) @ turn("y", t4) @ shift(0.17))
        @ (turn("x", t5) @ turn("z", t6) @ shift(0.31))
    )


def difference(q: Array, other: Array) -> Array:
    """Greatest difference of a joint, by whole turns."""
    result: Array = np.abs(np.angle(np.exp(1j * (q - other)))).max(axis=-1)
    return result


def test_the_forward_kinematics_is_that_of_the_chain_of_joints() -> None:
    for q in np.random.default_rng(1).uniform(-np.pi, np.pi, (50, 6)):
        assert np.abs(titan.forward(q) - chain(q)).max() < 1e-14


@pytest.mark.nightly
def test_every_branch_of_100000_poses_reaches_its_pose_to_1e_12() -> None:
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (100_000, 6))
    poses = titan.forward(q)
    branches = titan.inverse(poses)
    assert branches.exists.any(axis=1).all()
    error = np.abs(titan.forward(branches.q) - poses[:, None])
    assert error[branches.exists].max() < 1e-12
    assert np.isnan(branches.q[~branches.exists]).all()


@pytest.mark.long
def test_among_the_branches_is_the_configuration_that_the_pose_came_from() -> None:
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (100_000, 6))
    branches = titan.inverse(titan.forward(q))
    own = np.where(branches.exists, difference(branches.q, q[:, None]), np.inf).min(axis=1)
    assert own.max() < 1e-6  # a joint is no better known than the distance to the nearest singularity lets it


def test_a_pose_well_inside_the_workspace_has_eight_different_solutions() -> None:
    # the azimuth turned about needs reach behind the arm, so the wrist stays near
    branches = titan.inverse(titan.forward(np.array([0.3, 1.2, 2.0, -0.5, 0.4, 0.7])))
    assert branches.exists.all()
    for first in range(8):
        for second in range(first):
            assert difference(branches.q[first], branches.q[second]) > 0.1


def test_no_pose_that_has_a_solution_inside_the_limits_is_missed() -> None:
    q = np.random.default_rng(4).uniform(LOWER, UPPER, (20_000, 6))
    nearest = titan.inverse(titan.forward(q)).nearest(np.zeros(6), LOWER, UPPER)
    assert np.isfinite(nearest).all()
    assert np.all((nearest >= LOWER) & (nearest <= UPPER))


def test_a_pose_out_of_reach_is_told_and_not_clipped() -> None:
    pose = np.eye(4)
    pose[2, 3] = 1.93  # the arm stretched out reaches 1.92 m
    branches = titan.inverse(pose)
    assert not branches.exists.any()
    assert np.isnan(branches.q).all()


def test_the_arm_stretched_out_is_still_in_reach() -> None:
    q = np.array([0.4, 0.3, 0.0, 0.0, 0.0, 0.2])
    branches = titan.inverse(titan.forward(q))
    assert difference(branches.q[branches.exists], q).min() < 1e-6


def test_a_pose_too_near_to_the_shoulder_is_out_of_reach() -> None:
    q = np.array([0.0, 0.5, np.pi, 0.0, 0.0, 0.0])
    pose = titan.forward(q)
    wrist = pose[:3, 3] - 0.31 * pose[:3, 2] - 0.17 * pose[:3, 2]
    shoulder = np.array([0.0, 0.0, 0.12])
    pose[:3, 3] -= 0.05 * (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    branches = titan.inverse(pose)
    assert not branches.exists[:2].any()


@pytest.mark.parametrize("t5", [np.pi / 2, -np.pi / 2])
def test_with_the_wrist_bent_square_the_pitch_is_free_and_follows_the_hint(t5: float) -> None:
    q = np.array([0.5, 0.7, 0.9, -0.6, t5, 0.8])
    pose = titan.forward(q)
    branches = titan.inverse(pose, hint=q)
    assert branches.free["t2+t3+t4"]
    assert not branches.free["t1"]
    assert np.nanmin(np.where(branches.exists, difference(branches.q, q), np.inf)) < 1e-12
    assert np.abs(titan.forward(branches.q[branches.exists]) - pose).max() < 1e-12


def test_with_the_pitch_free_the_hint_counts_for_its_own_azimuth() -> None:
    q = np.array([0.5 + np.pi - 2 * np.pi, 2.6, 1.2, -0.9, np.pi / 2, 0.8])
    branches = titan.inverse(titan.forward(q), hint=q)
    assert np.nanmin(np.where(branches.exists, difference(branches.q, q), np.inf)) < 1e-12


def test_with_the_wrist_on_the_azimuth_axis_t1_is_free_and_follows_the_hint() -> None:
    # rho = L1 + L2 cos t2 + L3 cos(t2 + t3) + L4 cos(Phi) = 0
    t2, pitch = 1.4, 0.4
    t3 = np.arccos(-(0.12 + 0.84 * np.cos(t2) + 0.17 * np.cos(pitch)) / 0.48) - t2
    q = np.array([0.9, t2, t3, pitch - t2 - t3, 0.3, 0.5])
    pose = titan.forward(q)
    branches = titan.inverse(pose, hint=q)
    assert branches.free["t1"]
    assert np.nanmin(np.where(branches.exists, difference(branches.q, q), np.inf)) < 1e-9
    assert np.abs(titan.forward(branches.q[branches.exists]) - pose).max() < 1e-12


@pytest.mark.parametrize("distance", [1e-15, 1e-12, 1e-11, 1e-9, 1e-7, 1e-5])
def test_near_singularities_the_round_trip_stays_exact(distance: float) -> None:
    generator = np.random.default_rng(5)
    q = generator.uniform(-np.pi, np.pi, (2000, 6))
    q[:1000, 4] = np.pi / 2 - distance  # both at once has no solution that double precision could tell
    q[1000:, 2] = distance
    poses = titan.forward(q)
    branches = titan.inverse(poses)
    # where the pitch is free, that of the hint need not reach
    assert (branches.exists.any(axis=1) | branches.free["t2+t3+t4"]).all()
    assert branches.free["t2+t3+t4"].any() == (distance < 1e-13)
    error = np.abs(titan.forward(branches.q) - poses[:, None])
    assert error[branches.exists].max() < 1e-12


def test_a_tool_is_taken_off_before_anything_is_solved() -> None:
    T_hand_tool = turn("x", 0.3) @ shift(0.2) @ turn("y", -0.5)
    with_tool = TitanInverse(T_hand_tool=T_hand_tool)
    q = np.random.default_rng(6).uniform(-np.pi, np.pi, (500, 6))
    poses = titan.forward(q) @ T_hand_tool
    branches = with_tool.inverse(poses)
    assert np.nanmax(np.abs(titan.forward(branches.q) @ T_hand_tool - poses[:, None])) < 1e-12
    assert difference(branches.q, q[:, None])[branches.exists].min() < 1e-9


def test_other_lengths_are_other_arms() -> None:
    lengths = TitanLengths(azimuth=0.1, upper_arm=0.5, forearm=0.5, wrist=0.1, tool=0.0)
    arm = TitanInverse(lengths)
    q = np.random.default_rng(7).uniform(-np.pi, np.pi, (2000, 6))
    poses = arm.forward(q)
    branches = arm.inverse(poses)
    assert branches.exists.any(axis=1).all()
    assert np.abs(arm.forward(branches.q) - poses[:, None])[branches.exists].max() < 1e-12


def test_one_pose_gives_what_many_give() -> None:
    poses = titan.forward(np.random.default_rng(8).uniform(-1, 1, (3, 6)))
    many, one = titan.inverse(poses), titan.inverse(poses[1])
    assert one.q.shape == (8, 6)
    assert np.array_equal(one.q, many.q[1], equal_nan=True)


def test_solutions_are_fitted_to_limits_by_whole_turns() -> None:
    q = np.array([0.2, 0.4, 0.5, -0.3, 0.2, 3.0])
    branches = titan.inverse(titan.forward(q))
    wide = np.deg2rad([-350.0] * 6)
    fitted, inside = branches.fitted(q - 2 * np.pi * np.eye(6)[5], wide, -wide)
    assert inside[np.nanargmin(difference(branches.q, q))]
    assert np.abs(fitted[inside] - (q - 2 * np.pi * np.eye(6)[5])).max(axis=1).min() < 1e-12


@pytest.mark.parametrize("poses", [np.eye(3), np.zeros((2, 3, 4)), np.zeros((2, 2, 4, 4))])
def test_what_is_no_pose_is_refused(poses: Array) -> None:
    with pytest.raises(InverseError, match=r"\(4, 4\) or \(N, 4, 4\)"):
        titan.inverse(poses)


def test_a_hint_of_another_arm_is_refused() -> None:
    with pytest.raises(InverseError, match="six finite joint angles"):
        titan.inverse(np.eye(4), hint=np.zeros(7))


def test_a_pose_that_is_not_finite_has_no_solution() -> None:
    with np.errstate(invalid="ignore"):
        assert not titan.inverse(np.full((4, 4), np.nan)).exists.any()
