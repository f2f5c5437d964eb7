"""The lab cell: what stands in it, and where it starts."""

from itertools import combinations

import coal
import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.load import parse_cell
from deltaq_cell.robot import RobotModel


@pytest.fixture(scope="module")
def lab() -> CellModel:
    return CellModel.load("lab")


def placed_bodies(lab: CellModel) -> list[tuple[str, object, coal.Transform3s]]:
    """Every body with its world pose, all robots at home; placed here, not by the code that certifies."""
    bodies = [(body.name, body.geometry, body.placement) for body in lab.structure]
    for robot in lab.robots.values():
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, np.array(robot.home))
        for body in robot.geometry.geometryObjects:
            bodies.append((body.name, body.geometry, data.oMi[body.parentJoint] * body.placement))
    return [
        (name, shape, coal.Transform3s(place.rotation, place.translation)) for name, shape, place in bodies
    ]


def test_at_home_all_bodies_are_clear(lab: CellModel) -> None:
    never = {pair for robot in lab.robots.values() for pair in robot.never_checked_pairs()}
    gate = lab.description.gate
    checked = 0
    for (a, shape_a, pose_a), (b, shape_b, pose_b) in combinations(placed_bodies(lab), 2):
        group_a, group_b = a.split("/")[0], b.split("/")[0]
        if (group_a == group_b == "structure") or tuple(sorted((a, b))) in never:
            continue
        distance = coal.distance(
            shape_a, pose_a, shape_b, pose_b, coal.DistanceRequest(), coal.DistanceResult()
        )
        assert distance > (2 * gate.self_stop_distance_m if group_a == group_b else 0.15), (
            f"{a} {b} {distance}"
        )
        checked += 1
    assert checked > 1000


def test_at_home_the_camera_looks_at_the_leaders_tool_with_its_roll_right(lab: CellModel) -> None:
    fr, gr = lab.robots["fr"], lab.robots["gr"]
    camera, focus = fr.camera_pose(fr.home), gr.forward(gr.home)
    ray = focus[:3, 3] - camera[:3, 3]
    distance = np.linalg.norm(ray)
    assert 1.1 < distance < 1.3
    assert np.degrees(np.arccos(camera[:3, 2] @ ray / distance)) < 0.2
    assert abs(camera[2, 1]) < 0.01  # the picture's horizontal is level
    assert camera[2, 0] > 0.9  # and its x axis points up
    np.testing.assert_allclose(focus[:3, 3], [-0.4, -0.7, 1.3], atol=0.01)
    np.testing.assert_allclose(focus[:3, 2], [0, 0, -1], atol=1e-3)


def test_every_joint_starts_well_inside_its_limits(lab: CellModel) -> None:
    for robot in lab.robots.values():
        room = np.minimum(robot.home - robot.lower, robot.upper - robot.home)
        assert (room > np.where(robot.revolute, np.radians(20), 0.15)).all()


def test_the_robots_stand_where_the_lab_has_them(lab: CellModel) -> None:
    fr = lab.robots["fr"]
    np.testing.assert_allclose(fr.T_world_base[:3, 3], [-0.402, 0.486, 0])
    np.testing.assert_allclose(fr.T_world_base[:3, 0], [0, -1, 0], atol=1e-12)  # yaw -90
    np.testing.assert_allclose(lab.robots["gr"].T_world_base, np.eye(4))


def test_the_limits_are_the_labs_own(lab: CellModel) -> None:
    lower, upper = [-180, -150, -125, -345, -125, -345], [180, 30, 139, 345, 125, 345]
    for robot in lab.robots.values():
        np.testing.assert_allclose(np.degrees(robot.lower[-6:]), lower)
        np.testing.assert_allclose(np.degrees(robot.upper[-6:]), upper)
        np.testing.assert_allclose(np.degrees(robot.max_velocity[-6:]), [156, 156, 156, 330, 330, 615])
        np.testing.assert_allclose(robot.max_acceleration[-6:], [10.9, 4.5, 20.6, 92.8, 89.3, 120])
    gantry = lab.robots["gr"]
    np.testing.assert_allclose(gantry.lower[:3], [0, 0, -1.6])
    np.testing.assert_allclose(gantry.upper[:3], [1.54, 4.7, 0])
    np.testing.assert_allclose(gantry.max_velocity[:3], [0.5, 0.83, 0.55])


def test_the_structure_has_at_least_25_bodies_of_pipes_tanks_and_valves(lab: CellModel) -> None:
    names = [body.name for body in lab.structure]
    assert len(names) >= 25
    for kind in ("pipe", "tank", "valve", "platform", "floor"):
        assert any(name.startswith(f"structure/{kind}") for name in names)


def test_the_gantrys_bodies_fill_the_labs_boxes(lab: CellModel) -> None:
    """Boxes at e = 0 as measured: (low, high) corners in the world."""
    measured = {
        "gr/portal": ((0.157, -3.28, 0.242), (1.442, 3.334, 4.113)),
        "gr/trolley": ((-0.047, 1.818, 3.213), (1.114, 2.797, 4.559)),
        "gr/column": ((-0.112, 1.982, 3.104), (0.518, 2.612, 6.036)),
    }
    gantry = lab.robots["gr"]
    for part, box in measured.items():
        corners = []
        for body in gantry.geometry.geometryObjects:
            if body.name.startswith(part):
                body.geometry.computeLocalAABB()
                low, high = body.geometry.aabb_local.min_, body.geometry.aabb_local.max_
                corners += [body.placement.act(np.array(low)), body.placement.act(np.array(high))]
        np.testing.assert_allclose([np.min(corners, axis=0), np.max(corners, axis=0)], box, atol=1e-3)


def test_a_client_can_model_the_cell_from_the_description_message_alone(lab: CellModel) -> None:
    message = CellModel.load("lab-4ms").description_message()
    cell = parse_cell(message.yaml)
    for name, robot in lab.robots.items():
        rebuilt = RobotModel(cell.robots[name], name, urdf=message.urdf[name], hulls=message.hulls[name])
        np.testing.assert_allclose(rebuilt.forward(robot.home), robot.forward(robot.home), atol=1e-12)
        assert rebuilt.geometry.ngeoms == robot.geometry.ngeoms
    summary = message.robots["gr"]
    assert summary.units == ("m",) * 3 + ("rad",) * 6
    np.testing.assert_allclose(summary.max_increment, np.array(summary.max_velocity) * 0.004)
    assert {name: len(hulls) for name, hulls in message.hulls.items()} == {"fr": 6, "gr": 6}
