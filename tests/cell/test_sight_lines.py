"""Lines of sight: what they pass is what coal finds on them, whatever was left out before."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.sight_lines import NEAR_EYE_M, NEAR_TARGET_M, ROD_M, SightLines


@pytest.fixture(scope="module")
def lab() -> CellModel:
    return CellModel.load("lab")


def on_the_line(
    cell: CellModel, configurations: dict[str, np.ndarray], eye: np.ndarray, target: np.ndarray
) -> set[str]:
    """Every body of the cell that a rod from eye to target touches, none left out."""
    along = (target - eye) / np.linalg.norm(target - eye)
    begin, end = eye + NEAR_EYE_M * along, target - NEAR_TARGET_M * along
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    rod = coal.Capsule(ROD_M, float(np.linalg.norm(end - begin)))
    pose = coal.Transform3s(rotation, (begin + end) / 2)
    found = set()
    placed = [(body, body.placement) for body in cell.structure]
    for name, robot in cell.robots.items():
        data, geometry_data = robot.model.createData(), robot.geometry.createData()
        pin.updateGeometryPlacements(robot.model, data, robot.geometry, geometry_data, configurations[name])
        placed += list(zip(robot.geometry.geometryObjects, geometry_data.oMg, strict=True))
    for body, where in placed:
        place = coal.Transform3s(where.rotation, where.translation)
        distance = coal.distance(
            rod, pose, body.geometry, place, coal.DistanceRequest(), coal.DistanceResult()
        )
        if distance <= 0.0:
            found.add(body.name)
    return found


def test_a_sight_line_passes_the_same_bodies_as_exhaustive_measurement(lab: CellModel) -> None:
    lines, random = SightLines(lab), np.random.default_rng(0)
    passed = 0
    for _ in range(150):
        q = {name: random.uniform(robot.lower, robot.upper) for name, robot in lab.robots.items()}
        eye, target = random.uniform([-1.5, -3.0, 0.0], [1.5, 1.5, 2.5], (2, 3))
        lines.place(q)
        found = lines.blocked_by(eye, target)
        assert set(found) == on_the_line(lab, q, eye, target)
        passed += len(found)
    assert passed > 20, "many lines pass something"


def test_bodies_are_listed_from_the_eye_outwards(lab: CellModel) -> None:
    lines = SightLines(lab)
    there = lines.blocked_by(np.array([-0.04, 0.0, 0.8]), np.array([-0.04, -2.34, 0.8]))
    back = lines.blocked_by(np.array([-0.04, -3.0, 0.8]), np.array([-0.04, 0.0, 0.8]))
    assert there[0] == "structure/wheel_1"
    assert back[-1] == "structure/wheel_1"
    assert {"structure/pipe_3", "structure/valve_1"} <= set(back)


def test_bodies_at_the_target_or_at_the_eye_hide_nothing(lab: CellModel) -> None:
    lines = SightLines(lab)
    top_of_tank, up = np.array([-0.8, -2.67, 1.02]), np.array([0.0, 0.0, 1.0])
    for height_m in (0.6, 0.001, 0.0):
        assert lines.blocked_by(top_of_tank + height_m * up, top_of_tank) == ()


def measured_beside(
    cell: CellModel, lines: SightLines, eye: np.ndarray, target: np.ndarray
) -> dict[str, float]:
    """Distance of every structure body from a line, none left out but those at the target."""
    along = (target - eye) / np.linalg.norm(target - eye)
    begin, end = eye + NEAR_EYE_M * along, target - NEAR_TARGET_M * along
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    rod = coal.Capsule(ROD_M, float(np.linalg.norm(end - begin)))
    pose, found = coal.Transform3s(rotation, (begin + end) / 2), {}
    for body in cell.structure:
        place = coal.Transform3s(body.placement.rotation, body.placement.translation)
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        found[body.name] = coal.distance(rod, pose, body.geometry, place, request, result)
    return {name: distance for name, distance in found.items() if name not in lines.bodies_at(target)}


def test_bodies_beside_a_line_are_found_with_a_direction_that_clears_it(lab: CellModel) -> None:
    lines, random, moved = SightLines(lab), np.random.default_rng(1), 0
    for _ in range(400):
        eye, target = random.uniform([-1.5, -3.0, 0.0], [1.5, 1.5, 2.5], (2, 3))
        found = {body.name: body for body in lines.beside(eye, target, 0.1)}
        near = {name: d for name, d in measured_beside(lab, lines, eye, target).items() if d < 0.1}
        structure = {name: body for name, body in found.items() if name.startswith("structure/")}
        assert structure.keys() <= near.keys()
        assert all(near[name] == pytest.approx(body.distance_m, abs=1e-6) for name, body in structure.items())
        along = (target - eye) / np.linalg.norm(target - eye)
        for name, body in structure.items():
            assert abs(body.aside @ along) < 1e-9
            assert np.linalg.norm(body.aside) == pytest.approx(1.0)
            if not 0.05 < body.share < 0.8 or abs(body.distance_m) < 2e-3:
                continue
            # a millimetre at the body, by the eye alone
            shifted = {
                b.name: b for b in lines.beside(eye + 1e-3 / (1.0 - body.share) * body.aside, target, 0.2)
            }
            moved += name not in shifted or shifted[name].distance_m > body.distance_m
            assert name not in shifted or shifted[name].distance_m > body.distance_m - 1e-6
    assert moved > 50


def test_a_body_at_the_target_is_not_beside_the_line(lab: CellModel) -> None:
    lines = SightLines(lab)
    (panel,) = (body for body in lab.structure if body.name == "structure/panel")
    target = np.array(panel.placement.translation)
    assert lines.bodies_at(target) == ("structure/panel",)
    assert "structure/panel" not in {
        body.name for body in lines.beside(target + np.array([0.0, 1.5, 0.5]), target, 0.1)
    }
    assert lines.beside(target, target, 0.1) == ()
