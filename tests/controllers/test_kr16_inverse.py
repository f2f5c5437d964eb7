"""The closed form of the KR 16 against the robot's own model."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.models import load_urdf
from deltaq_controllers.inverse.kr16 import FOREARM_ANGLE, Kr16Inverse
from deltaq_protocol.arrays import Array

kr16 = Kr16Inverse()
model = pin.buildModelFromXML(load_urdf("kr16").text)
data = model.createData()
FLANGE = model.getFrameId("flange")


def pose(q: Array) -> Array:
    """The flange as the model has it."""
    pin.forwardKinematics(model, data, q)
    T: Array = pin.updateFramePlacement(model, data, FLANGE).homogeneous
    return T


def poses(q: Array) -> Array:
    """The flange of many configurations (N, 6), joint by joint from the model's own placements."""
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    signs = (-1, 1, 1, -1, 1, -1)
    axes = (2, 1, 1, 0, 1, 0)
    for joint in range(6):
        angle = signs[joint] * q[:, joint]
        turn = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
        i, j = [(1, 2), (2, 0), (0, 1)][axes[joint]]
        turn[:, i, i] = turn[:, j, j] = np.cos(angle)
        turn[:, i, j], turn[:, j, i] = -np.sin(angle), np.sin(angle)
        T = T @ model.jointPlacements[joint + 1].homogeneous @ turn
    flange: Array = T @ model.frames[FLANGE].placement.homogeneous
    return flange


def difference(q: Array, other: Array) -> Array:
    """Greatest difference of a joint, by whole turns."""
    result: Array = np.abs(np.angle(np.exp(1j * (q - other)))).max(axis=-1)
    return result


def test_many_poses_are_placed_as_the_model_places_one() -> None:
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (50, 6))
    assert np.abs(poses(q) - np.array([pose(one) for one in q])).max() < 1e-14


@pytest.mark.nightly
def test_every_branch_of_100000_poses_reaches_its_pose_to_1e_12() -> None:
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (100_000, 6))
    wanted = poses(q)
    branches = kr16.inverse(wanted)
    assert branches.exists.any(axis=1).all()
    for branch in range(8):
        there = branches.exists[:, branch]
        assert np.abs(poses(branches.q[there, branch]) - wanted[there]).max() < 1e-12
    own = np.where(branches.exists, difference(branches.q, q[:, None]), np.inf).min(axis=1)
    assert own.max() < 1e-6


def test_a_pose_near_the_base_has_eight_different_solutions() -> None:
    branches = kr16.inverse(pose(np.deg2rad([20, -100, 120, 30, 40, 50])))
    assert branches.exists.all()
    for first in range(8):
        for second in range(first):
            assert difference(branches.q[first], branches.q[second]) > 0.1


def test_the_branches_are_in_the_order_that_is_told() -> None:
    branches = kr16.inverse(pose(np.deg2rad([20, -100, 120, 30, 40, 50])))
    assert np.all(np.cos(branches.q[:4, 0] - np.deg2rad(20)) > 0)
    assert np.all(np.cos(branches.q[4:, 0] - np.deg2rad(20)) < 0)
    elbow = np.sin(branches.q[:, 2] + FOREARM_ANGLE)
    assert np.all(elbow[[0, 1, 4, 5]] >= 0)
    assert np.all(elbow[[2, 3, 6, 7]] <= 0)
    assert np.all(branches.q[0::2, 4] >= 0)
    assert np.all(branches.q[1::2, 4] <= 0)


def test_a_pose_out_of_reach_is_told() -> None:
    T = np.eye(4)
    T[0, 3] = 2.0
    branches = kr16.inverse(T)
    assert not branches.exists.any()
    assert np.isnan(branches.q).all()


def test_with_a_straight_wrist_a4_is_free_and_follows_the_hint() -> None:
    q = np.deg2rad([20.0, -60, 70, 33, 0, -50])
    wanted = pose(q)
    branches = kr16.inverse(wanted, hint=q)
    assert branches.free["a4"]
    assert np.nanmin(np.where(branches.exists, difference(branches.q, q), np.inf)) < 1e-12
    assert np.abs(poses(branches.q[branches.exists]) - wanted).max() < 1e-12


def test_with_the_wrist_over_the_base_a1_is_free_and_follows_the_hint() -> None:
    # 0.26 + 0.68 cos A2 + L cos(A2 + A3 + psi) = 0
    a2 = np.deg2rad(-110)
    end = -np.arccos(-(0.26 + 0.68 * np.cos(a2)) / np.hypot(0.67, 0.035))
    q = np.array([0.7, a2, end - a2 - FOREARM_ANGLE, 0.3, 0.6, 0.2])
    wanted = pose(q)
    branches = kr16.inverse(wanted, hint=q)
    assert branches.free["a1"]
    assert np.nanmin(np.where(branches.exists, difference(branches.q, q), np.inf)) < 1e-9
    assert np.abs(poses(branches.q[branches.exists]) - wanted).max() < 1e-12


def test_a_tool_is_taken_off_first() -> None:
    T_flange_tool = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.4, 0.8), np.array([0.02, -0.05, 0.28])).homogeneous
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (500, 6))
    branches = Kr16Inverse(T_flange_tool).inverse(poses(q) @ T_flange_tool)
    own = np.where(branches.exists, difference(branches.q, q[:, None]), np.inf).min(axis=1)
    assert own.max() < 1e-6


@pytest.mark.parametrize("distance", [1e-15, 1e-13, 1e-10, 1e-7])
def test_near_a_straight_wrist_the_round_trip_stays_exact(distance: float) -> None:
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (1000, 6))
    q[:, 4] = distance
    wanted = poses(q)
    branches = kr16.inverse(wanted)
    for branch in range(8):
        there = branches.exists[:, branch]
        assert np.abs(poses(branches.q[there, branch]) - wanted[there]).max() < 1e-12
