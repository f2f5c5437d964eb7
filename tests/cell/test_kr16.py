"""The KR 16's model against its data sheet, and against kinematics computed here."""

import math
from pathlib import Path

import numpy as np
import pytest
from data_sheet import ARM, BOXES, GANTRY, MASSES, SECTIONS, describe

import make_kr16_meshes
from deltaq_cell.description import Pose
from deltaq_cell.models import ROBOTS, load_urdf
from deltaq_cell.robot import RobotModel

FLANGE = np.array([[0, 0, 1, 0.158], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])  # Ry(90), then z out
HANGING = np.array([[0, -1, 0, 0.177], [-1, 0, 0, 2.297], [0, 0, -1, 3.107], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def floor() -> RobotModel:
    return RobotModel(describe("kr16"), "fr")


@pytest.fixture(scope="module")
def gantry() -> RobotModel:
    return RobotModel(describe("kr16_gantry"), "gr")


def turn(axis: tuple[float, ...], angle: float) -> np.ndarray:
    """Rodrigues' formula, as a homogeneous matrix."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K
    return T


def shift(vector: tuple[float, ...] | np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = vector
    return T


def arm_forward(q: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    for (origin, axis, *_), angle in zip(ARM.values(), q, strict=True):
        T = T @ shift(origin) @ turn(axis, angle)
    return T @ FLANGE


def hull_planes(robot: RobotModel, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, outward unit normals and offsets of a body's convex hull as the robot carries it."""
    hull = robot.geometry.geometryObjects[robot.geometry.getGeometryId(name)].geometry
    points = np.array([hull.point(i) for i in range(hull.num_points)])
    corners = np.array([[points[hull.polygons(i)[k]] for k in range(3)] for i in range(hull.num_polygons)])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    inward = offsets < normals @ points.mean(axis=0)
    normals[inward], offsets[inward] = -normals[inward], -offsets[inward]
    return points, normals, offsets


def test_forward_kinematics_agree_with_the_data_sheet(floor: RobotModel) -> None:
    rng = np.random.default_rng(0)
    for q in rng.uniform(floor.lower, floor.upper, size=(50, 6)):
        np.testing.assert_allclose(floor.forward(q), arm_forward(q), atol=1e-9)


def test_all_zero_is_the_arm_stretched_out_level(floor: RobotModel) -> None:
    T = floor.forward(np.zeros(6))
    np.testing.assert_allclose(T[:3, 3], [0.26 + 0.68 + 0.67 + 0.158, 0, 0.64], atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-9)  # z points out of the flange


def test_positive_a1_turns_clockwise_seen_from_above(floor: RobotModel) -> None:
    T = floor.forward([math.radians(90), 0, 0, 0, 0, 0])
    np.testing.assert_allclose(T[:3, 3], [0, -1.768, 0.64], atol=1e-9)


def test_the_wrist_reaches_as_far_as_the_catalogue_says(floor: RobotModel) -> None:
    reach = 0.0
    for a3 in np.radians(np.linspace(-10, 10, 2001)):
        origins = floor.joint_origins([0, 0, a3, 0, 0, 0])
        reach = max(reach, float(np.linalg.norm(origins[4] - origins[1])) + 0.26)
    assert reach == pytest.approx(1.611, abs=5e-4)


@pytest.mark.parametrize(
    ("e", "position"), [((0, 0, 0), (0.177, 2.297, 3.107)), ((0.532, 3.532, -0.892), (-0.355, -1.235, 2.215))]
)
def test_the_gantry_carries_the_hanging_base_where_the_lab_measured_it(
    gantry: RobotModel, e: tuple[float, ...], position: tuple[float, ...]
) -> None:
    q = np.array([*e, 0, 0, 0, 0, 0, 0])
    base = gantry.forward(q) @ np.linalg.inv(arm_forward(np.zeros(6)))
    np.testing.assert_allclose(base[:3, 3], position, atol=1e-9)
    np.testing.assert_allclose(base[:3, :3], HANGING[:3, :3], atol=1e-9)  # z down, x along -y


def test_gantry_kinematics_are_three_shifts_and_the_arm(gantry: RobotModel) -> None:
    rng = np.random.default_rng(1)
    for q in rng.uniform(gantry.lower, gantry.upper, size=(50, 9)):
        moved = sum(value * np.array(axis) for value, (axis, *_) in zip(q[:3], GANTRY.values(), strict=True))
        expected = shift(moved) @ HANGING @ arm_forward(q[3:])
        np.testing.assert_allclose(gantry.forward(q), expected, atol=1e-9)


@pytest.mark.parametrize("model", ["kr16", "kr16_gantry"])
def test_urdf_limits_agree_with_the_data_sheet(model: str) -> None:
    robot = RobotModel(describe(model), "r")
    np.testing.assert_allclose(robot.model.lowerPositionLimit, robot.lower, atol=1e-8)
    np.testing.assert_allclose(robot.model.upperPositionLimit, robot.upper, atol=1e-8)
    np.testing.assert_allclose(robot.model.velocityLimit, robot.max_velocity, atol=1e-8)


def test_links_carry_their_masses(floor: RobotModel, gantry: RobotModel) -> None:
    np.testing.assert_allclose([body.mass for body in floor.model.inertias][1:], [*MASSES, 0])
    np.testing.assert_allclose([body.mass for body in gantry.model.inertias][4:], [*MASSES, 0])


def test_the_hanging_arm_is_the_arm_on_the_floor() -> None:
    floor_text, gantry_text = load_urdf("kr16").text, load_urdf("kr16_gantry").text
    arm = floor_text[floor_text.index('  <link name="base">') :]
    assert gantry_text.endswith(arm)


@pytest.mark.parametrize("link", SECTIONS)
def test_the_hull_of_a_link_contains_its_sections(floor: RobotModel, link: str) -> None:
    _, normals, offsets = hull_planes(floor, f"fr/{link}")
    for xs, ys, zs in SECTIONS[link]:
        for corner in [(x, y, z) for x in xs for y in ys for z in zs]:
            assert (normals @ np.array(corner) <= offsets + 1e-6).all(), f"{corner} sticks out of {link}"


def test_the_hull_of_link_4_contains_its_tube(floor: RobotModel) -> None:
    _, normals, offsets = hull_planes(floor, "fr/link_4")
    angles = np.linspace(0, 2 * np.pi, 721)
    for x in (-0.268, -0.202):
        ring = np.column_stack([np.full_like(angles, x), 0.077 * np.cos(angles), 0.077 * np.sin(angles)])
        assert (ring @ normals.T <= offsets + 1e-6).all()


def test_the_collision_body_of_link_6_is_the_flange_disc(floor: RobotModel) -> None:
    disc = floor.geometry.geometryObjects[floor.geometry.getGeometryId("fr/link_6")]
    ends = [disc.placement.act(np.array([0, 0, s * disc.geometry.halfLength])) for s in (-1, 1)]
    np.testing.assert_allclose(ends, [(0.146, 0, 0), (0.158, 0, 0)], atol=1e-9)
    assert disc.geometry.radius == 0.039


@pytest.mark.parametrize("link", BOXES)
def test_hulls_are_convex_closed_and_no_larger_than_the_links_box(floor: RobotModel, link: str) -> None:
    points, normals, offsets = hull_planes(floor, f"fr/{link}")
    assert (points @ normals.T <= offsets + 1e-5).all()
    assert len(normals) == 2 * len(points) - 4  # Euler, for triangles
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], BOXES[link], atol=0.0025)


def test_checked_bodies_enclose_everything_drawn(floor: RobotModel) -> None:
    checked = 0
    for body in floor.visual.geometryObjects:
        link, _, _ = body.name.rpartition("_")
        if link in SECTIONS:
            _, normals, offsets = hull_planes(floor, f"fr/{link}")
            points = np.array(body.geometry.vertices())
            assert (points @ normals.T <= offsets + 1e-6).all(), f"{body.name} is drawn outside its hull"
            checked += 1
    assert checked == 12


def test_the_meshes_agree_with_their_script() -> None:
    folder = Path(ROBOTS, "kr16", "meshes")
    committed = {str(p.relative_to(folder)): p.read_text(encoding="ascii") for p in folder.rglob("*.obj")}
    assert committed == make_kr16_meshes.meshes()


def test_the_base_pose_moves_the_whole_robot(floor: RobotModel) -> None:
    pose = Pose(position_m=(-0.402, 0.486, 0.1), rpy_deg=(0, 0, -90))
    moved = RobotModel(describe("kr16", base=pose), "fr")
    q = np.radians([10, -80, 70, 20, 30, 40])
    T_world_base = shift(pose.position_m) @ turn((0, 0, 1), -math.pi / 2)
    np.testing.assert_allclose(moved.T_world_base, T_world_base, atol=1e-12)
    np.testing.assert_allclose(moved.forward(q), T_world_base @ floor.forward(q), atol=1e-12)
    base = moved.geometry.geometryObjects[moved.geometry.getGeometryId("fr/base")]
    np.testing.assert_allclose(base.placement.homogeneous, T_world_base, atol=1e-12)
