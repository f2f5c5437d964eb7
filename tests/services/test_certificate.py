"""I2: what is certified really keeps its distance, as dense samples of an oracle show."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spans import exact_drives

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_services.sim.certificate import Certifier
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tube import Branch, Span, tube
from deltaq_testing.oracle import ClearanceOracle

LAG = 6


@pytest.fixture(scope="module")
def cell():
    return CellModel.load("lab")


@pytest.fixture(scope="module")
def proximity(cell):
    return CompiledProximity(cell)


@pytest.fixture(scope="module")
def oracle(cell):
    return ClearanceOracle(cell)


def at_rest(q):
    return tube(np.tile(q, (LAG, 1)), Branch(np.zeros_like(q), 1, 1), exact_drives(LAG, q.size))


def moving(cell, name, q, dq):
    cycle_s = cell.description.cycle_s
    cycles = Limits.of(cell.robots[name].description, cycle_s).brake_cycles(dq)
    history = q - dq * np.arange(LAG - 1, -1, -1)[:, None]
    return tube(history, Branch(dq, cycles, -1), exact_drives(LAG, q.size))


def test_the_homes_are_certified_with_the_distance_the_oracle_measures(cell, proximity, oracle):
    homes = {name: robot.home for name, robot in cell.robots.items()}
    certificate = Certifier(proximity).certify("fr", at_rest(homes["fr"]), [("gr", at_rest(homes["gr"]))])
    assert certificate.holds
    assert certificate.binding.nearest.distance_m >= oracle.of_one_robot(homes).distance_m - 1e-6


def test_a_robot_in_the_floor_is_not_certified_and_the_pair_is_named(cell, proximity):
    q = cell.robots["fr"].home.copy()
    q[1] = np.deg2rad(30)
    certificate = Certifier(proximity).certify("fr", at_rest(q), [])
    assert not certificate.holds
    near = certificate.binding
    assert near.nearest.distance_m < near.stop_distance_m
    assert "structure/floor" in near.nearest.pair


@pytest.mark.long
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1))
def test_no_sample_of_a_certified_tube_is_nearer_than_the_stop_distance(cell, proximity, oracle, seed):
    random = np.random.default_rng(seed)
    cycle_s = cell.description.cycle_s
    tubes, points = {}, {}
    for name, robot in cell.robots.items():
        near_home = robot.home + random.uniform(-1, 1, robot.n) * 0.15 * (robot.upper - robot.lower)
        q = np.clip(near_home, robot.lower, robot.upper)
        dq = random.uniform(-1, 1, robot.n) * robot.max_velocity * cycle_s * random.uniform(0, 1)
        tubes[name] = moving(cell, name, q, dq)
        points[name] = tubes[name].points
    for name, other in (("fr", "gr"), ("gr", "fr")):
        certificate = Certifier(proximity).certify(name, tubes[name], [(other, tubes[other])])
        if not certificate.holds:
            continue
        for _ in range(25):
            here = {
                robot: rows[0] + random.uniform() * (rows[-1] - rows[0]) for robot, rows in points.items()
            }
            nearest = oracle.between_robots_and_structure(here)
            if nearest.pair[0].startswith(name) or nearest.pair[1].startswith(name):
                assert nearest.distance_m >= 0.05


@pytest.mark.long
def test_travel_bounds_the_motion_of_every_corner_within_the_box(cell, proximity):
    """The swept distance is a lower bound of the distance at any configuration of the box."""
    random = np.random.default_rng(3)
    homes = {name: robot.home for name, robot in cell.robots.items()}
    still = {name: np.zeros_like(q) for name, q in homes.items()}
    for _ in range(20):
        half = {name: random.uniform(0, 0.06, q.size) for name, q in homes.items()}
        swept = {}
        for name, q in homes.items():
            proximity.place(name, q, half[name])
        groups = {
            "fr": proximity.alone["fr"], "gr": proximity.alone["gr"], "both": proximity.between["fr", "gr"]
        }  # fmt: skip
        for key, members in groups.items():
            swept[key] = [proximity.least(group) for group in members]
        for _ in range(5):
            for name, q in homes.items():
                proximity.place(name, q + random.uniform(-1, 1, q.size) * half[name], still[name])
            for key, members in groups.items():
                for group, bound in zip(members, swept[key], strict=True):
                    assert proximity.least(group) >= bound - 1e-6


def test_the_order_of_the_queries_changes_no_bit(cell, proximity):
    random = np.random.default_rng(5)
    groups = [group for name in proximity.names for group in proximity.alone[name]]
    for name, robot in cell.robots.items():
        proximity.place(name, robot.home, np.full(robot.n, 0.01))
    first = {id(group): proximity.least(group) for group in groups}
    for _ in range(5):
        for name, robot in cell.robots.items():
            q = np.clip(robot.home + random.uniform(-0.3, 0.3, robot.n), robot.lower, robot.upper)
            proximity.place(name, q, np.full(robot.n, 0.02))
        for index in random.permutation(len(groups)):
            proximity.least(groups[index])
        for name, robot in cell.robots.items():
            proximity.place(name, robot.home, np.full(robot.n, 0.01))
        for index in random.permutation(len(groups)):
            assert proximity.least(groups[index]) == first[id(groups[index])]


def test_an_empty_budget_means_no(cell, proximity):
    q = cell.robots["fr"].home
    far = Span.around(
        np.array([q, np.clip(q + 1.0, cell.robots["fr"].lower, cell.robots["fr"].upper)]), np.zeros(6), 0.0
    )
    assert not Certifier(proximity, budget=0).certify("fr", far, []).holds
