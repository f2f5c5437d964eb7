import numpy as np
import pytest
from closed_loop import lab

from deltaq_controllers.camera.repulsion import Potential, Repulsion, push
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.spheres import Spheres, cover, local_box

FLOOR_ROBOT, GANTRY_ROBOT = lab().robots["fr"], lab().robots["gr"]
POTENTIAL = Potential(gain=2e-3, range_m=0.3, min_m=0.03)
CAP = 0.012 * FLOOR_ROBOT.max_velocity
NOTHING = np.zeros((0, 3)), np.zeros(0)


def potential_energy(
    centres: np.ndarray, radii: np.ndarray, obstacles: np.ndarray, sizes: np.ndarray
) -> float:
    between = np.linalg.norm(centres[:, None] - obstacles[None], axis=2)
    d = between - radii[:, None] - sizes[None]
    pushed = np.maximum(1.0 / d - 1.0 / POTENTIAL.range_m, 0.0)
    return float(0.5 * POTENTIAL.gain * (pushed**2).sum())


def test_the_field_is_the_gradient_of_khatibs_potential() -> None:
    kinematics, spheres = Kinematics(FLOOR_ROBOT, "camera"), Spheres.of(FLOOR_ROBOT)
    repulsion = Repulsion(FLOOR_ROBOT, POTENTIAL, CAP, floor_m=None)
    q = np.deg2rad([10.0, -90, 80, 20, 40, 0])
    kinematics.update(q)
    obstacles = kinematics.position + np.array([[0.3, 0.1, 0.2], [-0.2, -0.3, -0.1], [0.0, 0.3, -0.35]])
    sizes = np.array([0.05, 0.1, 0.08])
    clearance = repulsion.approach(kinematics, obstacles, sizes)
    assert 0.03 < clearance < 0.3

    def energy(q: np.ndarray) -> float:
        kinematics.update(q)
        return potential_energy(spheres.placed(kinematics.placements()), spheres.radii, obstacles, sizes)

    downhill = [-(energy(q + d) - energy(q - d)) / 2e-6 for d in 1e-6 * np.eye(6)]
    kinematics.update(q)
    np.testing.assert_allclose(repulsion.field(kinematics), downhill, rtol=1e-4, atol=1e-7)


def test_the_floor_pushes_from_the_foot_point_straight_up() -> None:
    kinematics, spheres = Kinematics(FLOOR_ROBOT, "camera"), Spheres.of(FLOOR_ROBOT)
    q = np.deg2rad([0.0, -10, 60, 0, 20, 0])
    kinematics.update(q)
    lowest = float((spheres.placed(kinematics.placements())[:, 2] - spheres.radii).min())
    floor = lowest - 0.1
    repulsion = Repulsion(FLOOR_ROBOT, POTENTIAL, CAP, floor_m=floor)
    assert np.isinf(repulsion.approach(kinematics, *NOTHING))  # no law gives up the view for a floor
    moving = spheres.joints > 1

    def energy(q: np.ndarray) -> float:
        kinematics.update(q)
        d = spheres.placed(kinematics.placements())[moving, 2] - spheres.radii[moving] - floor
        return float(0.5 * POTENTIAL.gain * (np.maximum(1 / d - 1 / POTENTIAL.range_m, 0) ** 2).sum())

    downhill = [-(energy(q + d) - energy(q - d)) / 2e-6 for d in 1e-6 * np.eye(6)]
    kinematics.update(q)
    field = repulsion.field(kinematics)
    np.testing.assert_allclose(field, downhill, rtol=1e-4, atol=1e-7)
    assert field[0] == pytest.approx(0.0, abs=1e-12)


def test_the_floor_does_not_push_a_link_that_turns_about_the_vertical() -> None:
    kinematics, spheres = Kinematics(FLOOR_ROBOT, "camera"), Spheres.of(FLOOR_ROBOT)
    kinematics.update(FLOOR_ROBOT.home)
    first_link = spheres.joints == 1
    beneath = float((spheres.placed(kinematics.placements())[:, 2] - spheres.radii)[first_link].min()) + 0.05
    repulsion = Repulsion(FLOOR_ROBOT, POTENTIAL, CAP, floor_m=beneath)
    assert repulsion.approach(kinematics, *NOTHING) > 0.0


def test_overlapping_bodies_are_pushed_apart_with_bounded_force() -> None:
    kinematics, spheres = Kinematics(FLOOR_ROBOT, "camera"), Spheres.of(FLOOR_ROBOT)
    repulsion = Repulsion(FLOOR_ROBOT, POTENTIAL, CAP, floor_m=None)
    kinematics.update(np.deg2rad([0.0, -90, 90, 0, 30, 0]))
    outermost = spheres.placed(kinematics.placements())[-1]
    obstacle = outermost[None] + np.array([[0.0, -0.02, 0.0]])
    assert repulsion.approach(kinematics, obstacle, np.array([0.1])) < 0
    field = repulsion.field(kinematics)
    kinematics.update(np.deg2rad([0.0, -90, 90, 0, 30, 0]) + 1e-4 * field / np.linalg.norm(field))
    assert (spheres.placed(kinematics.placements())[-1] - outermost)[1] > 0
    assert push(POTENTIAL, -1.0) == push(POTENTIAL, 0.03)


def test_bodies_out_of_range_are_not_pushed() -> None:
    kinematics = Kinematics(FLOOR_ROBOT, "camera")
    repulsion = Repulsion(FLOOR_ROBOT, POTENTIAL, CAP, floor_m=None)
    assert repulsion.approach(kinematics, *NOTHING) == np.inf
    assert repulsion.approach(kinematics, np.array([[5.0, 5.0, 5.0]]), np.array([0.1])) > 1.0
    np.testing.assert_array_equal(repulsion.field(kinematics), np.zeros(6))


@pytest.mark.parametrize("_", range(20))
def test_ignoring_distant_bodies_changes_nothing_within_one_increment(
    _: int, random: np.random.Generator
) -> None:
    kinematics, spheres = Kinematics(FLOOR_ROBOT, "camera"), Spheres.of(FLOOR_ROBOT)
    repulsion = Repulsion(FLOOR_ROBOT, POTENTIAL, CAP, floor_m=None)
    q = random.uniform(FLOOR_ROBOT.lower, FLOOR_ROBOT.upper)
    kinematics.update(q)
    obstacles = kinematics.position + random.normal(scale=0.4, size=(30, 3))
    sizes = random.uniform(0.02, 0.1, 30)
    repulsion.approach(kinematics, obstacles, sizes)
    moved = q + random.choice([-1.0, 1.0], 6) * CAP
    kinematics.update(moved)
    field = repulsion.field(kinematics)
    centres = spheres.placed(kinematics.placements())
    # every pair, with Jacobians by finite differences
    apart = centres[:, None] - obstacles[None]
    between = np.linalg.norm(apart, axis=2)
    pushes = np.vectorize(lambda d: push(POTENTIAL, d))(between - spheres.radii[:, None] - sizes[None])
    force = (pushes[:, :, None] * apart / between[:, :, None]).sum(axis=1)
    expected = []
    for d in 1e-6 * np.eye(6):
        kinematics.update(moved + d)
        ahead = spheres.placed(kinematics.placements())
        kinematics.update(moved - d)
        expected.append(float((force * (ahead - spheres.placed(kinematics.placements())) / 2e-6).sum()))
    np.testing.assert_allclose(field, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("robot", [FLOOR_ROBOT, GANTRY_ROBOT])
def test_the_spheres_contain_every_moving_body(robot: object, random: np.random.Generator) -> None:
    spheres = Spheres.of(robot)  # type: ignore[arg-type]  # pytest's parameters have no type
    for body in robot.geometry.geometryObjects:  # type: ignore[attr-defined]  # likewise
        if body.parentJoint == 0:
            continue
        low, high = local_box(body)
        points = random.uniform(low, high, (200, 3))
        points[:8] = [[(low, high)[b >> k & 1][k] for k in range(3)] for b in range(8)]
        in_joint = np.array([body.placement.act(point) for point in points])
        mine = spheres.joints == body.parentJoint
        away = np.linalg.norm(in_joint[:, None] - spheres.centres[mine][None], axis=2)
        assert (away <= spheres.radii[mine][None] + 1e-9).any(axis=1).all()


def test_a_long_body_is_covered_by_a_row_of_small_spheres() -> None:
    row = cover(np.array([0.0, -0.1, -0.1]), np.array([1.0, 0.1, 0.1]))
    assert len(row) == 5
    assert all(radius < 0.2 for _, radius in row)
