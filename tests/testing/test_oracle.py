"""The oracle sees what it is there to see."""

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_emulator.recorder import CsvRecorder, Sample
from deltaq_emulator.states import KrcState
from deltaq_testing.oracle import ClearanceOracle, PairDistances, limit_violations, record_cycle_s

CELL = CellModel.load("lab")
FR = CELL.robots["fr"]
HOMES = {name: robot.home for name, robot in CELL.robots.items()}


def test_a_robot_in_the_floor_is_found():
    q = FR.home.copy()
    q[1] = np.deg2rad(30)
    near = ClearanceOracle(CELL).between_robots_and_structure(HOMES | {"fr": q})
    assert near.distance_m < 0
    assert "structure/floor" in near.pair


def test_distances_do_not_depend_on_earlier_measurements():
    oracle = ClearanceOracle(CELL)
    first = oracle.between_robots_and_structure(HOMES)
    oracle.between_robots_and_structure(HOMES | {"fr": FR.home + 0.3})
    assert oracle.between_robots_and_structure(HOMES).distance_m == pytest.approx(first.distance_m, abs=1e-9)


def along_a_random_course(random, cycles=60):
    """Both robots at full speed, and every twenty cycles somewhere else altogether."""
    for cycle in range(cycles):
        if cycle % 20 == 0:
            q = {name: random.uniform(robot.lower, robot.upper) for name, robot in CELL.robots.items()}
            dq = {
                name: random.uniform(-1, 1, robot.n) * robot.max_velocity * 0.012
                for name, robot in CELL.robots.items()
            }
        q = {name: here + dq[name] for name, here in q.items()}
        yield q


@pytest.mark.long
def test_an_unmeasured_pair_is_never_the_nearest():
    course = list(along_a_random_course(np.random.default_rng(1)))
    oracle = ClearanceOracle(CELL)
    for q in course:
        anew = ClearanceOracle(CELL)  # which has measured nothing before, and so measures all
        for look in ("between_robots_and_structure", "between_robots", "of_one_robot"):
            found, true = getattr(oracle, look)(q), getattr(anew, look)(q)
            assert found.distance_m == pytest.approx(true.distance_m, abs=1e-5)


@pytest.mark.long
def test_an_unmeasured_pair_is_at_least_as_far_as_its_bound():
    oracle = ClearanceOracle(CELL)
    limits = oracle.stop_distances_m
    anything = np.full(limits.shape, np.inf)
    for q in along_a_random_course(np.random.default_rng(2)):
        found, true = oracle.distances_m(q, limits), ClearanceOracle(CELL).distances_m(q, anything)
        near = true < limits
        assert found[near] == pytest.approx(true[near], abs=1e-5)
        assert np.all(found <= true + 1e-5)
        assert np.all(found[~near] >= limits[~near])
        level = limits - 0.01
        assert oracle.least_room_m(q, level) == pytest.approx((true - level).min(), abs=1e-5)


def test_along_a_motion_few_pairs_are_measured(monkeypatch):
    oracle = ClearanceOracle(CELL)
    measured = []
    measure = PairDistances._measure
    monkeypatch.setattr(PairDistances, "_measure", lambda *seen: measured.append(seen) or measure(*seen))
    oracle.between_robots_and_structure(HOMES)
    every_pair = len(measured)
    measured.clear()
    for cycle in range(50):
        oracle.between_robots_and_structure(HOMES | {"fr": FR.home + 0.005 * cycle})
    assert 50 <= len(measured) < every_pair


@pytest.mark.parametrize(
    ("what", "rows"),
    [
        ("position", [FR.upper + 1e-3] * 3),
        ("velocity", [FR.home, FR.home + FR.max_velocity * 0.0121]),
        ("acceleration", [FR.home, FR.home, FR.home + FR.max_acceleration * 0.012**2 * 1.01]),
    ],
)
def test_an_exceeded_limit_is_counted(what, rows):
    found = limit_violations(FR, np.array(rows), 0.012)
    assert getattr(found, f"{what}_violations") > 0


def test_an_arm_is_judged_by_the_time_of_its_own_controller(tmp_path):
    """Steps that are slow enough at 12 ms, of a controller that ticks every 4 ms."""
    recorder, rows = CsvRecorder(0.004, FR.n), [FR.home + 0.9 * FR.max_velocity * 0.012 * k for k in range(3)]
    recorder.start(tmp_path / "fr.csv")
    for cycle, q in enumerate(rows, start=7):
        recorder.row(Sample(cycle, 0, q, q, KrcState.RSI_RUNNING, None, {}))
    recorder.stop()
    cycle_s = record_cycle_s(tmp_path / "fr.csv")
    assert cycle_s == pytest.approx(0.004)
    assert limit_violations(FR, np.array(rows), 0.012).velocity_violations == 0
    assert limit_violations(FR, np.array(rows), cycle_s).velocity_violations == 2 * FR.n


def test_a_robot_at_rest_exceeds_no_limit():
    assert limit_violations(FR, np.array([FR.home] * 5), 0.012).total == 0
