"""The oracle sees what it is there to see."""

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_experiments.oracle import ClearanceOracle, limit_violations

CELL = CellModel.load("lab")
FR = CELL.robots["fr"]
HOMES = {name: robot.home for name, robot in CELL.robots.items()}


def test_a_robot_in_the_floor_is_seen():
    q = FR.home.copy()
    q[1] = np.deg2rad(30)
    near = ClearanceOracle(CELL).between_robots_and_structure(HOMES | {"fr": q})
    assert near.distance_m < 0
    assert "structure/floor" in near.pair


def test_distances_do_not_depend_on_what_was_measured_before():
    oracle = ClearanceOracle(CELL)
    first = oracle.between_robots_and_structure(HOMES)
    oracle.between_robots_and_structure(HOMES | {"fr": FR.home + 0.3})
    assert oracle.between_robots_and_structure(HOMES).distance_m == pytest.approx(first.distance_m, abs=1e-9)


@pytest.mark.parametrize(
    ("what", "rows"),
    [
        ("position", [FR.upper + 1e-3] * 3),
        ("velocity", [FR.home, FR.home + FR.max_velocity * 0.0121]),
        ("acceleration", [FR.home, FR.home, FR.home + FR.max_acceleration * 0.012**2 * 1.01]),
    ],
)
def test_a_limit_that_is_passed_is_counted(what, rows):
    found = limit_violations(FR, np.array(rows), 0.012)
    assert getattr(found, what) > 0


def test_standing_still_passes_nothing():
    assert limit_violations(FR, np.array([FR.home] * 5), 0.012).total == 0
