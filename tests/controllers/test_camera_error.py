import math

import numpy as np
import pytest
from closed_loop import lab, with_camera

from deltaq_cell.description import Camera, Pose
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.error import (
    ANTIPODE_RAD,
    easiest_way_round,
    look,
    view_angle,
    view_jacobians,
)
from deltaq_controllers.kinematics import Kinematics

STEP = 1e-6


def a_rotation(random: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


@pytest.mark.parametrize("_", range(20))
def test_the_size_of_psi_is_the_tangent_of_half_the_view_angle(_: int, random: np.random.Generator) -> None:
    rotation, position, focus = a_rotation(random), random.normal(size=3), random.normal(size=3)
    y = rotation.T @ (focus - position) / np.linalg.norm(focus - position)
    view = look(rotation, position, focus)
    np.testing.assert_allclose(view.psi, y[:2] / (1.0 + y[2]), rtol=1e-9)
    assert math.isclose(np.linalg.norm(view.psi), math.tan(view.angle / 2), rel_tol=1e-9)
    assert math.isclose(view.angle, view_angle(rotation, position, focus), rel_tol=1e-9)
    assert math.isclose(view.distance, float(np.linalg.norm(focus - position)))


@pytest.mark.parametrize("_", range(10))
def test_p_is_the_derivative_of_psi_by_the_focus(_: int, random: np.random.Generator) -> None:
    rotation, position, focus = a_rotation(random), random.normal(size=3), random.normal(size=3)
    view = look(rotation, position, focus)
    numeric = np.column_stack(
        [
            (look(rotation, position, focus + d).psi - look(rotation, position, focus - d).psi) / (2 * STEP)
            for d in STEP * np.eye(3)
        ]
    )
    np.testing.assert_allclose(view.P, numeric, rtol=1e-5, atol=1e-6 * view.stretch**2)


OFF_AXIS = Camera(pose=Pose(position_m=(0.06, -0.02, 0.15), rpy_deg=(10, -20, 170)))


@pytest.mark.parametrize(
    "kinematics",
    [
        pytest.param(Kinematics(lab().robots["fr"], "camera"), id="floor robot"),
        pytest.param(Kinematics(with_camera(OFF_AXIS), "camera"), id="lens off the axis of A6"),
        pytest.param(Kinematics(lab().robots["gr"], "tool"), id="gantry with prismatic joints"),
    ],
)
@pytest.mark.parametrize("_", range(4))
def test_the_task_jacobian_is_the_derivative_of_psi_by_the_joints(
    kinematics: Kinematics, _: int, random: np.random.Generator
) -> None:
    n = kinematics.model.nv
    q, focus = random.uniform(-1.0, 1.0, n), random.normal(size=3)

    def psi(q: np.ndarray) -> np.ndarray:
        kinematics.update(q)
        return look(kinematics.rotation, kinematics.position, focus).psi

    numeric = np.column_stack([(psi(q + d) - psi(q - d)) / (2 * STEP) for d in STEP * np.eye(n)])
    kinematics.update(q)
    view = look(kinematics.rotation, kinematics.position, focus)
    jacobian, _ = view_jacobians(view, kinematics.position, focus, kinematics.twists)
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-5, atol=1e-5 * view.stretch**2)


@pytest.mark.parametrize("name", ["fr", "gr"])
def test_one_pass_gives_the_poses_and_jacobians_of_the_robots_model(
    name: str, random: np.random.Generator
) -> None:
    robot: RobotModel = lab().robots[name]
    kinematics = Kinematics(robot, "tool")
    for q in random.uniform(robot.lower, robot.upper, (5, robot.n)):
        kinematics.update(q)
        pose = robot.forward(q)
        np.testing.assert_allclose(kinematics.rotation, pose[:3, :3], atol=1e-12)
        np.testing.assert_allclose(kinematics.position, pose[:3, 3], atol=1e-12)
        np.testing.assert_allclose(kinematics.jacobian(), robot.jacobian(q), atol=1e-12)


@pytest.mark.parametrize("off", [0.0, 1e-13, 1e-9, 0.5 * ANTIPODE_RAD])
def test_exactly_behind_the_camera_all_is_finite_and_the_given_direction_of_rotation_is_used(
    off: float,
) -> None:
    behind = np.array([-math.sin(off), 0.0, -math.cos(off)])
    way = np.array([0.6, 0.8])
    view = look(np.eye(3), np.zeros(3), behind, way)
    assert view.undecided
    assert math.isclose(view.angle, math.pi - ANTIPODE_RAD)
    assert all(np.isfinite(part).all() for part in (view.psi, view.P, view.u))
    np.testing.assert_allclose(view.direction, -way if off else way, atol=1e-9)
    assert math.isclose(math.atan(np.linalg.norm(view.psi)) * 2, view.angle, rel_tol=1e-9)


def test_nearly_behind_the_camera_the_rotation_takes_the_short_direction() -> None:
    angle = math.pi - 2 * ANTIPODE_RAD
    view = look(np.eye(3), np.zeros(3), np.array([0.0, -math.sin(angle), math.cos(angle)]))
    assert not view.undecided
    np.testing.assert_allclose(view.direction, [0.0, -1.0])
    assert math.isclose(view.angle, angle)


def test_a_focus_in_the_lens_counts_as_straight_ahead(random: np.random.Generator) -> None:
    view = look(a_rotation(random), np.ones(3), np.ones(3))
    assert view.angle == pytest.approx(0.0, abs=1e-12)
    assert np.isfinite(view.P).all()


def test_from_a_focus_behind_the_camera_on_the_axis_of_a1_the_rotation_goes_over_the_top() -> None:
    robot = lab().robots["fr"]
    kinematics = Kinematics(robot, "camera")
    kinematics.update(np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]))
    base = robot.T_world_base[:3, 3]
    focus = np.array([base[0], base[1], kinematics.position[2]])
    view = look(kinematics.rotation, kinematics.position, focus)
    assert view.undecided
    # e1 is up in the picture: no joint can move this focus sideways
    np.testing.assert_allclose(
        np.abs(easiest_way_round(kinematics.rotation, focus, kinematics.twists)), [1.0, 0.0], atol=1e-9
    )
