import math

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, with_camera

from deltaq_cell.description import Camera, Pose
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.error import look
from deltaq_controllers.camera.law import CameraLaw, FollowerGains
from deltaq_controllers.kinematics import Kinematics
from deltaq_protocol.arrays import Array

FREE = FollowerGains(damping=1e-6, turn_rad_s2=1e9, repulsion=0.0)
OFF_AXIS = Camera(pose=Pose(position_m=(0.06, 0.02, 0.17), rpy_deg=(0, 10, 180)))
FOLDED = np.deg2rad([0.0, -100, 90, 10, 40, 0])
NOTHING = np.zeros((0, 3)), np.zeros(0)


def looking(
    q: Array, robot: RobotModel | None = None, gains: FollowerGains | None = None
) -> tuple[CameraLaw, Kinematics]:
    """The law of FR's camera, and FR at `q`."""
    robot = robot or lab().robots["fr"]
    law = CameraLaw(robot, CYCLE_S, CYCLE_S * robot.max_velocity, gains or FollowerGains(), floor_m=None)
    kinematics = Kinematics(robot, "camera")
    kinematics.update(q)
    return law, kinematics


def decay(camera: Camera | None, random: np.random.Generator) -> float:
    """Decay rate over virtual time of the view angle, relative to k_p, at some configuration."""
    robot = lab().robots["fr"] if camera is None else with_camera(camera)
    q = random.uniform(0.6 * robot.lower, 0.6 * robot.upper)
    law, kinematics = looking(q, robot, FREE)
    focus = kinematics.position + random.normal(size=3)
    law.aim(q, focus, 0.0, 1.2, *NOTHING)
    step = 1e-7 * law.rates(q)

    def size(q: np.ndarray) -> float:
        kinematics.update(q)
        return math.log(look(kinematics.rotation, kinematics.position, focus).angle)

    return (size(q - step) - size(q + step)) / (2e-7 * FREE.direction)


@pytest.mark.parametrize("camera", [None, OFF_AXIS])
@pytest.mark.parametrize("_", range(8))
def test_the_view_angle_decays_at_k_p_with_any_sub_tasks(
    camera: Camera | None, _: int, random: np.random.Generator
) -> None:
    assert decay(camera, random) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("degrees", [1.0, 20.0, 170.0])
def test_the_task_rate_is_bounded_by_what_can_be_braked(degrees: float) -> None:
    gains, q = FollowerGains(turn_rad_s2=10.0), FOLDED
    law, kinematics = looking(q, gains=gains)
    angle = math.radians(degrees)
    axes = kinematics.rotation
    focus = kinematics.position + 1.2 * (math.cos(angle) * axes[:, 2] + math.sin(angle) * axes[:, 0])
    law.aim(q, focus, 0.0, 1.2, *NOTHING)
    rates = law.rates(q)
    kinematics.update(q + 1e-7 * rates)
    after = look(kinematics.rotation, kinematics.position, focus).angle
    # the whole horizon is gone through in one cycle
    speed = (angle - after) / 1e-7 * gains.horizon_s / CYCLE_S
    assert speed <= math.sqrt(2 * gains.turn_rad_s2 * angle) * 1.001
    assert speed > 0.5 * min(math.sqrt(2 * gains.turn_rad_s2 * angle), gains.direction * angle)


def test_joints_with_reserve_compensate_for_joints_at_their_bounds() -> None:
    law, kinematics = looking(q := FOLDED)
    focus = kinematics.position + 1.2 * kinematics.rotation[:, 2]
    law.aim(q, focus, 0.0, 1.2, *NOTHING)
    view = look(kinematics.rotation, kinematics.position, focus)
    jacobian = view.P @ (kinematics.linear - np.cross(focus, kinematics.angular.T).T)
    wanted = np.array([0.002, 0.003, -0.002, 0.001, 0.001, 0.0])
    bound = np.array([0.01, 0.0005, 0.01, 0.02, 0.02, 0.02])
    kept = law.keep_looking(wanted, q, -bound, bound)
    assert (np.abs(kept) <= bound).all()
    clipped = np.clip(wanted, -bound, bound)
    assert np.linalg.norm(jacobian @ (clipped - wanted)) > 1e-4
    np.testing.assert_allclose(jacobian @ kept, jacobian @ wanted, atol=1e-5)
    np.testing.assert_array_equal(law.keep_looking(clipped, q, -bound, bound), clipped)


@pytest.mark.parametrize("away", [True, False])
def test_a_joint_leaves_its_bound_only_before_the_focus_is_lost(away: bool) -> None:
    law, kinematics = looking(q := FOLDED)
    # the focus five degrees above the view axis, or below it; A5 cannot but nod, and A3 could make up for it
    nod = kinematics.angular[:, 4] @ np.cross(kinematics.rotation[:, 2], kinematics.rotation[:, 0])
    side = math.copysign(math.sin(math.radians(5.0)), nod if away else -nod)
    focus = kinematics.position + kinematics.rotation[:, 2] - side * kinematics.rotation[:, 0]
    law.aim(q, focus, 0.0, 1.2, *NOTHING)
    view = look(kinematics.rotation, kinematics.position, focus)
    jacobian = -view.P @ (kinematics.linear - np.cross(focus, kinematics.angular.T).T)
    dq, slowest, fastest = np.zeros(6), np.zeros(6), np.zeros(6)
    slowest[4] = fastest[4] = 0.002
    assert (view.direction @ jacobian[:, 4] > 0.0) == away
    needed = float(-jacobian[:, 4] @ jacobian[:, 2])
    slowest[2], fastest[2] = sorted((math.copysign(1e-5, needed), math.copysign(0.02, needed)))
    kept = law.keep_looking(dq, q, slowest, fastest)
    turned = view.direction @ jacobian @ kept
    clipped = view.direction @ jacobian @ np.clip(dq, slowest, fastest)
    if away:
        assert turned < 0.1 * clipped
    else:
        assert turned == clipped
