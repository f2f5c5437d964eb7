"""Lines of sight: what they pass is what coal finds on them, whatever was left out before."""

from __future__ import annotations

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


def test_a_line_passes_the_bodies_that_all_of_them_measured_say(lab: CellModel) -> None:
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


def test_bodies_are_told_from_the_eye_on(lab: CellModel) -> None:
    lines = SightLines(lab)
    there = lines.blocked_by(np.array([-0.04, 0.0, 0.8]), np.array([-0.04, -2.34, 0.8]))
    back = lines.blocked_by(np.array([-0.04, -3.0, 0.8]), np.array([-0.04, 0.0, 0.8]))
    assert there[0] == "structure/wheel_1"
    assert back[-1] == "structure/wheel_1"
    assert {"structure/pipe_3", "structure/valve_1"} <= set(back)


def test_what_is_at_the_target_or_at_the_eye_hides_nothing(lab: CellModel) -> None:
    lines = SightLines(lab)
    top_of_tank, up = np.array([-0.8, -2.67, 1.02]), np.array([0.0, 0.0, 1.0])
    for height_m in (0.6, 0.001, 0.0):
        assert lines.blocked_by(top_of_tank + height_m * up, top_of_tank) == ()
