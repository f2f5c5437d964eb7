"""The performance criteria: each against finite differences, its limits, and what it says about known postures."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.proximity import ProximityEngine
from deltaq_controllers.criteria import BY_NAME, TABLE, Category, Criterion, Normalised, Postures, RobotData
from deltaq_controllers.criteria.bounds import ROUNDING_M
from deltaq_controllers.criteria.capsules import box_distance, box_points, segment_points
from deltaq_controllers.criteria.normalised import CriterionError, cost, references

CELLS = {"dawm": CellModel.load("dawm"), "gr": CellModel.load("lab")}
DATA = {name: RobotData(cell, name) for name, cell in CELLS.items()}
ALL = dict.fromkeys(BY_NAME, 1.0)


def some(data: RobotData, count: int, seed: int, share: float = 0.9) -> Postures:
    robot = data.robot
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    return Postures(
        data, middle + share * half * np.random.default_rng(seed).uniform(-1, 1, (count, robot.n))
    )


def test_each_category_of_the_paper_has_at_least_two_criteria() -> None:
    for category in Category:
        assert sum(criterion.category is category for criterion in TABLE) >= 2
    assert len(BY_NAME) == len(TABLE)


@pytest.mark.parametrize("robot", DATA)
@pytest.mark.parametrize("criterion", TABLE, ids=lambda criterion: criterion.name)
def test_a_gradient_agrees_with_finite_differences(criterion: Criterion, robot: str) -> None:
    postures = some(DATA[robot], 4 if criterion.name == "effective_mass_rate" else 10, seed=1)
    gradient = criterion.gradient(postures)
    step = 1e-6
    for joint in range(postures.q.shape[1]):
        offset = step * np.eye(postures.q.shape[1])[joint]
        ahead, behind = (Postures(postures.data, postures.q + sign * offset) for sign in (1, -1))
        numeric = (criterion.value(ahead) - criterion.value(behind)) / (2 * step)
        scale = max(1e-3, float(np.abs(gradient).max()))
        np.testing.assert_allclose(gradient[:, joint], numeric, atol=1e-6 * scale)


@pytest.mark.parametrize("robot", DATA)
def test_the_gradient_of_the_weighted_sum_agrees_with_finite_differences(robot: str) -> None:
    data = DATA[robot]
    weights = {name: 1.0 + 0.1 * k for k, name in enumerate(BY_NAME) if name != "effective_mass_rate"}
    total = Normalised(data, weights)
    postures = some(data, 4, seed=2)
    gradient = total.gradient(postures)
    for joint in range(data.robot.n):
        offset = 1e-6 * np.eye(data.robot.n)[joint]
        ahead, behind = (total.total(Postures(data, postures.q + sign * offset)) for sign in (1, -1))
        np.testing.assert_allclose(
            gradient[:, joint], (ahead - behind) / 2e-6, atol=1e-6 * np.abs(gradient).max()
        )


@pytest.mark.parametrize("robot", DATA)
def test_the_mass_matrix_is_pinocchios_with_the_drives_added(robot: str) -> None:
    data = DATA[robot]
    postures = some(data, 5, seed=3)
    model = data.robot.model
    for q, mass in zip(postures.q, postures.masses, strict=True):
        upper = np.triu(pin.crba(model, model.createData(), q))
        expected = upper + np.triu(upper, 1).T + np.diag(data.rotors)
        np.testing.assert_allclose(mass, expected, atol=1e-10)


def test_joints_in_their_middle_are_best_and_joints_at_a_limit_worst() -> None:
    data = DATA["dawm"]
    robot = data.robot
    q = np.array([0.5 * (robot.lower + robot.upper), robot.upper])
    np.testing.assert_allclose(BY_NAME["travel"].value(Postures(data, q)), [0, 1], atol=1e-12)
    limits = BY_NAME["limits"].value(Postures(data, q))
    assert limits[0] == pytest.approx(1)
    assert limits[1] > 1e5
    assert Normalised(data, {"limits": 1.0}).total(Postures(data, q))[1] > 0.99


def test_a_stretched_arm_is_singular_on_a_robot_that_has_nothing_but_the_arm() -> None:
    data = RobotData(CELLS["gr"], "fr")
    stretched = np.zeros((1, 6))
    bent = np.deg2rad([[0, -60, 80, 30, 50, 0]])
    for name in ("manipulability", "condition", "smallest_singular_value"):
        value = BY_NAME[name].value(Postures(data, np.vstack([stretched, bent])))
        assert value[0] < 1e-9
        assert value[1] > 1e-2
    assert np.isfinite(BY_NAME["manipulability"].gradient(Postures(data, stretched))).all()


def test_a_stiffer_joint_bends_less_and_all_in_one_joint_is_the_most_uneven() -> None:
    cell = CELLS["gr"]
    soft, stiff = (RobotData(cell, "fr", stiffness=np.full(6, k)) for k in (1e4, 1e5))
    q = some(soft, 5, seed=4).q
    ratio = BY_NAME["compliance"].value(Postures(soft, q)) / BY_NAME["compliance"].value(Postures(stiff, q))
    np.testing.assert_allclose(ratio, 10)
    one_soft = RobotData(cell, "fr", stiffness=np.array([1.0, 1e9, 1e9, 1e9, 1e9, 1e9]))
    partition = BY_NAME["potential_energy_partition"]
    assert np.all(partition.value(Postures(one_soft, q)) > 0.99)
    assert np.all(partition.value(Postures(soft, q)) >= 1 / 6)


def test_the_effective_mass_of_a_load_at_the_hand_is_not_less_than_that_load() -> None:
    data = RobotData(CELLS["gr"], "fr")
    light = BY_NAME["effective_mass"].value(some(data, 20, seed=5))
    joint, _, place = data.kinematics.hands[0]
    data.masses[joint], data.centres[joint] = 50.0, place
    heavy = BY_NAME["effective_mass"].value(some(data, 20, seed=5))
    assert np.all(heavy > light)
    assert np.all(heavy >= 50.0)


def test_the_room_of_capsules_is_near_to_what_exact_shapes_leave() -> None:
    cell, data = CELLS["dawm"], DATA["dawm"]
    proximity = ProximityEngine(cell)
    postures = some(data, 200, seed=6, share=0.6)
    off = []
    for q, room in zip(postures.q, postures.nearest.room, strict=True):
        proximity.place("dawm", q, np.zeros(17))
        exact = min(proximity.least(group) - group.stop_distance_m for group in proximity.alone["dawm"])
        if exact > 0:
            off.append(room - exact)
    assert len(off) > 50
    assert np.abs(off).max() < 0.06
    assert np.median(np.abs(off)) < 0.03


def test_one_configuration_is_measured_as_it_is_among_many() -> None:
    postures = some(DATA["dawm"], 300, seed=7)
    alone = [Postures(DATA["dawm"], q).nearest.room[0] for q in postures.q[::17]]
    np.testing.assert_allclose(postures.nearest.room[::17], alone, atol=1e-12)


@pytest.mark.parametrize("robot", DATA)
def test_the_tightest_pair_is_the_one_that_is_found_by_measuring_all(robot: str) -> None:
    field = DATA[robot].field
    postures = some(DATA[robot], 60, seed=12)
    middles, halves = field._placed(postures.frames, slice(0, 60))
    lower, upper = field._bounds.of(middles, halves)
    rows, pairs = np.nonzero(np.isfinite(lower))
    every = field._measured(middles, halves, rows, pairs).room
    shape = (60, -1)
    np.testing.assert_array_equal(postures.nearest.room, every.reshape(shape).min(axis=1))
    assert np.all(lower[rows, pairs] <= every + ROUNDING_M)
    assert np.all(upper[rows, pairs] >= every - ROUNDING_M)


def test_distances_of_segments_and_boxes_are_those_of_coal() -> None:
    rng = np.random.default_rng(8)
    for _ in range(200):
        c1, h1, c2, h2 = rng.uniform(-1, 1, (4, 1, 3)) * np.array([1, 0.4, 1, 0.4])[:, None, None]
        half = rng.uniform(0.1, 0.5, 3)
        on_first, on_second = segment_points(c1, h1, c2, h2)
        places = []
        for c, h in ((c1, h1), (c2, h2)):
            turn = pin.Quaternion.FromTwoVectors(np.array([0, 0, 1.0]), h[0]).toRotationMatrix()
            places.append((coal.Capsule(1e-9, 2 * float(np.linalg.norm(h))), coal.Transform3s(turn, c[0])))
        box = (coal.Box(*(2 * half)), coal.Transform3s(np.eye(3), np.zeros(3)))

        def exact(a: tuple[object, object], b: tuple[object, object]) -> float:
            result = coal.distance(*a, *b, coal.DistanceRequest(), coal.DistanceResult())
            return float(result)

        assert np.linalg.norm(on_first - on_second) == pytest.approx(exact(*places), abs=1e-5)
        _, _, distance = box_points(c1, h1, half[None])
        if exact(places[0], box) > 0.05:
            assert distance[0] == pytest.approx(exact(places[0], box), abs=5e-3)
    assert box_distance(np.array([0.0, 0.0, 0.1]), np.array([0.5, 0.5, 0.2])) == pytest.approx(-0.1)


def test_a_segment_that_is_a_point_is_measured_from_its_foot_on_the_other() -> None:
    along, point, none = np.array([[1.0, 0, 0]]), np.array([[0.7, 0.2, 0]]), np.zeros((1, 3))
    foot = np.array([[0.7, 0.0, 0.0]])
    for places in (segment_points(none, along, point, none), segment_points(point, none, none, along)[::-1]):
        np.testing.assert_allclose(places, [foot, point], atol=1e-12)


def test_costs_are_one_half_at_the_reference_and_lie_between_0_and_1_except_in_collision() -> None:
    data = DATA["dawm"]
    costs = Normalised(data, ALL).costs(some(data, 50, seed=9))
    names = list(BY_NAME)
    others = np.delete(costs, names.index("clearance"), axis=1)
    assert np.all((others >= 0) & (others <= 1))
    assert (costs[:, names.index("clearance")] > 1).any()
    for criterion, scale in zip(TABLE, references(data, TABLE), strict=True):
        assert cost(criterion, scale, np.array([scale])) == pytest.approx(0.5)
        worse = np.array([0.5 * scale, scale, 2 * scale])
        ordered = np.sort(cost(criterion, scale, worse))
        np.testing.assert_allclose(
            cost(criterion, scale, worse), ordered if criterion.better == "less" else ordered[::-1]
        )


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"travle": 1.0}, "no criterion 'travle'; there are travel, limits"),
        ({"travel": -1.0}, "weight of travel must be a finite number, 0 or more, got -1"),
        ({"travel": float("nan")}, "weight of travel must be"),
    ],
)
def test_a_weight_that_is_none_is_refused(weights: dict[str, float], message: str) -> None:
    with pytest.raises(CriterionError, match=message):
        Normalised(DATA["gr"], weights)
