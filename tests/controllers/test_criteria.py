"""The performance criteria: each against finite differences, its limits, and what it says about known postures."""

from itertools import combinations
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.criteria import BY_NAME, TABLE, Category, Criterion, Normalised, Postures, RobotData
from deltaq_controllers.criteria.near_bodies import FAR_M, SOFT_M, PairKind, least_gaps
from deltaq_controllers.criteria.table import CriterionError, cost, references

CELLS = {"dawm": CellModel.load("dawm"), "gr": CellModel.load("lab")}
DATA = {
    name: RobotData(cell, name, others={other: model.home for other, model in cell.robots.items()})
    for name, cell in CELLS.items()
}
CLEARANCES = {
    "obstacle_clearance": PairKind.ENVIRONMENT,
    "robot_clearance": PairKind.ROBOTS,
    "self_clearance": PairKind.SELF,
}
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


@pytest.mark.long
@pytest.mark.parametrize("robot", DATA)
@pytest.mark.parametrize("criterion", [one for one in TABLE if one.gradient], ids=lambda one: one.name)
def test_a_gradient_agrees_with_finite_differences(criterion: Criterion, robot: str) -> None:
    postures = clear(DATA[robot], 10, seed=1)
    assert criterion.gradient is not None
    gradient = criterion.gradient(postures)
    scale = max(1e-3, float(np.abs(gradient).max()))
    here = criterion.value(postures)
    # a distance is found to a few nanometres, and has a kink where faces are parallel: two one-sided derivatives
    is_distance = criterion.name.endswith("clearance")
    step, off = (1e-4, 3e-3) if is_distance else (1e-6, 1e-6)
    for joint in range(postures.q.shape[1]):
        offset = step * np.eye(postures.q.shape[1])[joint]
        ahead, behind = (
            criterion.value(Postures(postures.data, postures.q + sign * offset)) for sign in (1, -1)
        )
        if not is_distance:
            np.testing.assert_allclose(gradient[:, joint], (ahead - behind) / (2 * step), atol=off * scale)
            continue
        sides = np.sort([(ahead - here) / step, (here - behind) / step], axis=0)
        assert np.all(gradient[:, joint] >= sides[0] - off * scale)
        assert np.all(gradient[:, joint] <= sides[1] + off * scale)


@pytest.mark.parametrize("robot", DATA)
def test_the_gradient_of_the_weighted_sum_agrees_with_finite_differences(robot: str) -> None:
    data = DATA[robot]
    left_out = ("effective_mass_rate", "clearance", *CLEARANCES)  # they have a test of their own above
    weights = {name: 1.0 + 0.1 * k for k, name in enumerate(BY_NAME) if name not in left_out}
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


@pytest.mark.parametrize("robot", DATA)
def test_gravity_is_pinocchios(robot: str) -> None:
    data = DATA[robot]
    model = data.robot.model
    postures = some(data, 5, seed=16)
    for q, torque in zip(postures.q, postures.gravity, strict=True):
        expected = pin.computeGeneralizedGravity(model, model.createData(), q)
        np.testing.assert_allclose(torque, expected, atol=1e-3 * np.abs(expected).max())


def test_mirrored_arms_share_the_load_and_an_outstretched_arm_has_more() -> None:
    data = DATA["dawm"]
    out = data.robot.home.copy()
    out[[3, 4, 5]] = 0.0, 1.2, -0.2
    postures = Postures(data, np.array([data.robot.home, out]))
    for name in ("relative_load", "relative_energy"):
        even, uneven = BY_NAME[name].value(postures)
        assert even == pytest.approx(0.5, abs=1e-3)
        assert uneven > 0.51


def test_joints_in_their_middle_are_best_and_joints_at_a_limit_worst() -> None:
    data = DATA["dawm"]
    robot = data.robot
    q = np.array([0.5 * (robot.lower + robot.upper), robot.upper])
    np.testing.assert_allclose(BY_NAME["travel"].value(Postures(data, q)), [0, 1], atol=1e-12)
    limits = BY_NAME["limits"].value(Postures(data, q))
    assert limits[0] == pytest.approx(1)
    assert limits[1] > 1e5
    assert Normalised(data, {"limits": 1.0}).total(Postures(data, q))[1] > 0.99


def test_a_stretched_arm_without_base_joints_is_singular() -> None:
    data = RobotData(CELLS["gr"], "fr")
    stretched = np.zeros((1, 6))
    bent = np.deg2rad([[0, -60, 80, 30, 50, 0]])
    for name in ("manipulability", "condition", "smallest_singular_value"):
        value = BY_NAME[name].value(Postures(data, np.vstack([stretched, bent])))
        assert value[0] < 1e-9
        assert value[1] > 1e-2
    assert np.isfinite(Normalised(data, {"manipulability": 1.0}).gradient(Postures(data, stretched))).all()


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


def clear(data: RobotData, count: int, seed: int) -> Postures:
    """Configurations in which nothing overlaps: in depth a penetration has no derivative."""
    postures = some(data, 8 * count, seed)
    room = BY_NAME["clearance"].value(postures)
    return Postures(data, postures.q[room > 0.01][:count])


def test_a_smooth_clearance_underestimates_the_least_distance_within_its_bound() -> None:
    postures = clear(DATA["dawm"], 30, seed=6)
    near = postures.near
    for criterion, kind in CLEARANCES.items():
        value = BY_NAME[criterion].value(postures)
        for row in range(len(postures)):
            rooms = near.room[(near.row == row) & (near.kind == kind)]
            least, count = min(rooms.min(initial=FAR_M), FAR_M), len(rooms) + 1
            assert least - SOFT_M * np.log(count) - 1e-12 <= value[row] <= least + 1e-12


@pytest.mark.parametrize("robot", DATA)
def test_the_nearest_pair_of_each_kind_agrees_with_exhaustive_measurement(robot: str) -> None:
    cell, data = CELLS[robot], DATA[robot]
    for q in clear(data, 20, seed=12).q:
        told, every = data.bodies.nearest(q), all_rooms(cell, robot, data, q)
        for kind in PairKind:
            room_m, pair = min(every[kind], default=(np.inf, None))
            if room_m >= FAR_M:
                assert kind not in told
            else:
                assert told[kind].room_m == pytest.approx(room_m, abs=2e-6)
                assert frozenset(told[kind].pair) == pair


def all_rooms(
    cell: CellModel, robot: str, data: RobotData, q: np.ndarray[Any, Any]
) -> dict[PairKind, list[tuple[float, frozenset[str]]]]:
    """Room and names of every pair that the gate measures and the hands leave free, by coal body by body."""
    gate, model = cell.description.gate, cell.robots[robot]
    placed = {}
    for name, other in cell.robots.items():
        at = q if name == robot else other.home
        geometry = pin.GeometryData(other.geometry)
        pin.updateGeometryPlacements(other.model, other.model.createData(), other.geometry, geometry, at)
        for body, pose in zip(other.geometry.geometryObjects, geometry.oMg, strict=True):
            placed[body.name] = (body.geometry, pose, name, int(body.parentJoint) - 1)
    for body in cell.structure:
        placed[body.name] = (body.geometry, body.placement, "", -1)
    never = {frozenset(pair) for pair in model.never_checked_pairs()}
    last = {joint for joint, _, _ in data.kinematics.hands}
    found: dict[PairKind, list[tuple[float, frozenset[str]]]] = {kind: [] for kind in PairKind}
    for one, other in combinations(placed, 2):
        owners = {placed[one][2], placed[other][2]}
        joints = [placed[name][3] if placed[name][2] == robot else -1 for name in (one, other)]
        names = frozenset((one, other))
        if robot not in owners or names in never or joints[0] == joints[1]:
            continue
        if all(joint < 0 or joint in last for joint in joints):
            continue
        kind = (
            PairKind.SELF if owners == {robot} else PairKind.ENVIRONMENT if "" in owners else PairKind.ROBOTS
        )
        stop_m = gate.self_stop_distance_m if kind is PairKind.SELF else gate.stop_distance_m
        distance = coal.distance(
            placed[one][0], transform(placed[one][1]), placed[other][0], transform(placed[other][1]),
            coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        found[kind].append((float(distance) - stop_m, names))
    return found


def transform(pose: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(pose.rotation, pose.translation)


def test_a_hand_counts_only_against_bodies_that_the_joints_can_approach() -> None:
    data = DATA["dawm"]
    hands = {joint for joint, _, _ in data.kinematics.hands}
    assert len(hands) == 2
    carried = {
        body.name for body in data.robot.geometry.geometryObjects if int(body.parentJoint) - 1 in hands
    }
    for first, second in data.bodies.names:
        assert not (first in carried and (second in carried or second.startswith("structure/")))
    assert any(first in carried or second in carried for first, second in data.bodies.names)


def test_other_robots_count_where_they_are_placed() -> None:
    cell = CELLS["gr"]
    fr, criterion = cell.robots["fr"], BY_NAME["robot_clearance"]
    at_home = RobotData(cell, "gr", others={"fr": fr.home})
    drawn = clear(at_home, 100, seed=15)
    before = criterion.value(drawn)
    q = drawn.q[before < 0.2][:1]
    at_home.bodies.place({"fr": fr.home + np.array([2.5, 0, 0, 0, 0, 0])})
    assert criterion.value(Postures(at_home, q))[0] > before[before < 0.2][0]
    alone = RobotData(cell, "gr")
    assert not (Postures(alone, q).near.kind == PairKind.ROBOTS).any()


def test_a_regular_hand_does_not_hide_a_singular_one() -> None:
    data = DATA["dawm"]
    q = some(data, 1, seed=13).q
    better = BY_NAME["manipulability"]
    each = np.linalg.svd(Postures(data, q).jacobians, compute_uv=False).prod(axis=2)[0]
    assert each[0] != pytest.approx(each[1])
    assert better.value(Postures(data, q))[0] == pytest.approx(each.min())
    loads = BY_NAME["compliance"].value(Postures(data, q))[0]
    J = Postures(data, q).jacobians[0, :, :3]
    assert loads == pytest.approx((np.square(J) / data.stiffness).sum(axis=(1, 2)).max() / 3)


@pytest.mark.parametrize("robot", DATA)
def test_the_screen_never_overstates_the_distance_of_two_bodies(robot: str) -> None:
    data = DATA[robot]
    bodies = data.bodies
    for q in some(data, 20, seed=14).q:
        near = dict(bodies._measured(q))
        gaps = least_gaps(bodies._screen, np.concatenate(bodies._views), np.full(len(bodies.names), 5.0))
        for pair, room_m in near.items():
            if room_m > 0:
                assert gaps[pair] <= room_m + bodies._stops[pair] + 1e-9


def test_costs_are_one_half_at_the_reference_and_lie_between_0_and_1_except_in_collision() -> None:
    data = DATA["dawm"]
    costs = Normalised(data, ALL).costs(some(data, 50, seed=9))
    names = list(BY_NAME)
    clearances = [names.index(name) for name in ("clearance", *CLEARANCES)]
    others = np.delete(costs, clearances, axis=1)
    assert np.all((others >= 0) & (others <= 1))
    assert (costs[:, clearances] > 1).any()
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
def test_an_invalid_weight_is_refused(weights: dict[str, float], message: str) -> None:
    with pytest.raises(CriterionError, match=message):
        Normalised(DATA["gr"], weights)
