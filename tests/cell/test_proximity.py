"""What a look at bodies measures: how far each is inflated, what the screen leaves out, and what is told of a pair."""

import json
import sys

import numpy as np
import pinocchio as pin
import pytest
from ran import ran

from deltaq_cell.bodies import Extents
from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.kernel.look import _screen
from deltaq_cell.proximity import ProximityEngine
from deltaq_testing.oracle import ClearanceOracle

CELL = CellModel.load("lab")
GATE = CELL.description.gate
HOMES = {name: robot.home for name, robot in CELL.robots.items()}
STILL = {name: np.zeros(robot.n) for name, robot in CELL.robots.items()}
COAL_M = 2e-6
"""What iterations of coal may be off, which go differently from either body."""


@pytest.fixture
def by_coal():
    return ProximityEngine(CELL)


@pytest.fixture
def proximity():
    return CompiledProximity(CELL)


def drawn(seed):
    """Near home, and half-widths that make bodies travel some centimetres."""
    random = np.random.default_rng(seed)
    near = {name: q + random.uniform(-0.2, 0.2, q.size) for name, q in HOMES.items()}
    return near, {name: random.uniform(0, 0.03, q.size) for name, q in HOMES.items()}


def arms(name, q):
    """Per body of a robot how far it travels per unit of each joint: its furthest point's distance from the axis."""
    robot = CELL.robots[name]
    data = robot.model.createData()
    J = pin.computeJointJacobians(robot.model, data, q)
    found = {}
    for body in robot.geometry.geometryObjects:
        extents, placed = Extents([body]), data.oMi[body.parentJoint]
        corners = [placed.act(corner) for corner in extents.corners[0]]
        width = extents.disc[0] + extents.ball[0]
        found[body.name] = np.zeros(robot.n)
        for joint in robot.model.supports[body.parentJoint]:
            if joint > 0:
                v, w = J[:3, joint - 1], J[3:, joint - 1]
                furthest = max(np.linalg.norm(v + np.cross(w, corner)) for corner in corners)
                found[body.name][joint - 1] = furthest + (width if w.any() else 0.0)
    return found


def all_groups(proximity):
    return [*proximity.alone["fr"], *proximity.alone["gr"], *proximity.between["fr", "gr"]]


def test_a_body_is_inflated_by_its_travel_and_within_its_robot_by_the_relative_travel(by_coal):
    q, half = drawn(1)
    travels = {}
    for name in q:
        travels |= {body: arm * half[name] for body, arm in arms(name, q[name]).items()}
        greatest = by_coal.place(name, q[name], half[name])
        of_robot = [travel.sum() for body, travel in travels.items() if body.startswith(name)]
        assert greatest == pytest.approx(max(of_robot), abs=1e-12)
    for group in all_groups(by_coal):
        by_coal.least(group)
        for near in group.measured().values():
            first, second = (travels.get(body, np.zeros(1)) for body in near.pair)
            if near.pair[0].partition("/")[0] == near.pair[1].partition("/")[0]:
                first, second = first * (second == 0), second * (first == 0)
            assert near.distance_m - near.swept_m == pytest.approx(first.sum() + second.sum(), abs=1e-9)


def test_at_a_single_configuration_distances_agree_with_the_independent_checker(by_coal):
    q, _ = drawn(2)
    oracle = ClearanceOracle(CELL)
    for name in q:
        assert by_coal.place(name, q[name], STILL[name]) == 0.0
    least = {}
    for group in all_groups(by_coal):
        pair = group.pairs[0]
        own = pair[0].name.partition("/")[0] == pair[1].name.partition("/")[0]
        least[own] = min(least.get(own, np.inf), by_coal.least(group))
        assert group.stop_distance_m == (GATE.self_stop_distance_m if own else GATE.stop_distance_m)
    assert least[True] == pytest.approx(oracle.of_one_robot(q).distance_m, abs=COAL_M)
    assert least[False] == pytest.approx(oracle.between_robots_and_structure(q).distance_m, abs=COAL_M)


def test_between_two_robots_the_same_pairs_are_checked_in_either_order(by_coal):
    pairs = {
        names: {frozenset((one.name, other.name)) for group in groups for one, other in group.pairs}
        for names, groups in by_coal.between.items()
    }
    every = {
        frozenset((one.name, other.name))
        for one in CELL.robots["fr"].geometry.geometryObjects
        for other in CELL.robots["gr"].geometry.geometryObjects
    }
    assert pairs == {("fr", "gr"): every, ("gr", "fr"): every}


def test_both_bodies_of_a_pair_are_inflated_by_their_travel(by_coal):
    q, half = drawn(3)
    by_coal.place("fr", q["fr"], half["fr"])
    own = next(g for g in by_coal.alone["fr"] if g.pairs[0][1].name.startswith("fr"))
    foreign = next(g for g in by_coal.alone["fr"] if g.pairs[0][1].name.startswith("structure"))

    def inflated(group):
        by_coal.least(group)
        near = group.nearest()
        return near.distance_m - near.swept_m

    assert inflated(foreign) > 0.0
    assert inflated(own) > 0.0
    by_coal.place("fr", q["fr"], 2 * half["fr"])
    more = inflated(own)
    by_coal.place("fr", q["fr"], half["fr"])
    assert more == pytest.approx(2 * inflated(own))


LENS_IN_THE_FLOOR = np.radians([162.0, -5.0, 60.0, 247.0, -41.0, -97.0])


def test_penetration_deeper_than_the_thickness_of_a_body_is_measured(proximity):
    """The middle of the ball around it lies within the box around the other then."""
    proximity.place("fr", LENS_IN_THE_FLOOR, STILL["fr"])
    tool = next(
        g for g in proximity.alone["fr"] if g.pairs[0][1].name == "structure/floor" and len(g.pairs) > 1
    )
    lens = next(index for index, (body, _) in enumerate(tool.pairs) if body.name == "fr/tool_lens_left")
    single = proximity.pair(tool, lens)
    depth = proximity.least(single)
    assert depth < -0.06
    for stop_m, failing in ((depth + 1e-3, [single]), (depth - 1e-3, [])):
        single.stop_distance_m = stop_m
        assert proximity.look([single], 0.0).failing == failing
        others = [group for group in proximity.alone["fr"] if group is not tool]
        assert (single in proximity.look([*others, single], 0.0).failing) == bool(failing)


def screened(proximity, groups):
    """Rooms of all pairs by balls and boxes alone."""
    every = np.arange(len(groups.numbers))
    _screen(proximity._anatomy, proximity._where, groups.pairs, every, True, proximity._found)
    return proximity._found.room_m[: len(every)].copy()


def test_the_screen_never_understates_a_penetration(proximity):
    proximity.place("fr", LENS_IN_THE_FLOOR, STILL["fr"])
    groups = proximity.alone["fr"]
    for index, bound_m in enumerate(screened(proximity, groups)):
        nearest, stop_m = proximity._measure(groups, index)
        assert bound_m <= nearest.swept_m - stop_m + 1e-6


def test_the_screen_saves_most_distance_queries(proximity):
    for name, q in HOMES.items():
        proximity.place(name, q, STILL[name])
    rooms = np.concatenate([screened(proximity, groups) for groups in proximity.alone.values()])
    assert np.mean(rooms > 0.1) > 0.5


def test_the_tightest_pair_is_reported_with_its_clearance_even_if_it_passes(proximity):
    for name, q in HOMES.items():
        proximity.place(name, q, STILL[name])
    groups = proximity.alone["fr"]
    rooms = [proximity.least(group) - group.stop_distance_m for group in groups]
    for room_m in (-1.0, min(rooms) + 1e-4):
        look = proximity.look(groups, room_m)
        assert look.tightest.swept_m - look.stop_distance_m == pytest.approx(min(rooms), abs=COAL_M)
        assert len(look.failing) == sum(room < room_m for room in rooms)


def test_bodies_too_near_at_the_midpoint_are_distinguished_from_possible_approaches(proximity):
    q, half = drawn(1)
    group = proximity.alone["fr"][0]
    proximity.place("fr", q["fr"], half["fr"])
    proximity.least(group)
    near = group.nearest()
    middle, swept = near.distance_m - group.stop_distance_m, near.swept_m - group.stop_distance_m
    beyond = proximity.look([group], middle + 1e-4)
    assert (beyond.failing, beyond.too_near) == ([group], True)
    assert proximity.look([group], middle - 1e-6).too_near is False
    within = proximity.look([group], swept - 1e-6)
    assert (within.failing, within.too_near) == ([], False)


def test_each_pair_has_a_minimum_distance_of_its_own(proximity):
    q, half = drawn(6)
    proximity.place("fr", q["fr"], half["fr"])
    group = next(g for g in proximity.alone["fr"] if len(g.pairs) > 2)
    proximity.least(group)
    for index, near in group.measured().items():
        pair = proximity.pair(group, index)
        assert proximity.pair(group, index) is pair
        assert proximity.least(pair) == pytest.approx(near.swept_m, abs=1e-9)
        assert pair.nearest().pair == near.pair
        pair.stop_distance_m = near.swept_m - 1e-3
        assert proximity.look([pair], 0.0).failing == []
        pair.stop_distance_m = near.distance_m + 1e-3
        assert proximity.look([pair], 0.0).failing == [pair]
        assert group.stop_distance_m == GATE.stop_distance_m


def test_a_single_pair_is_checked_with_its_own_planes(proximity):
    """The room that planes show of a group is the least of what they show of its pairs."""
    q, _ = drawn(7)
    direction = 0.05 * np.sign(np.random.default_rng(7).normal(size=6))
    offsets, wide = np.array([-direction, direction, 0.2 * direction[::-1]]), np.full(6, 1e-3)
    proximity.place("fr", q["fr"], np.abs(direction) + wide, offsets, wide)

    def room(groups):
        low, high = -1.0, 1.0
        for _ in range(20):
            middle = (low + high) / 2
            low, high = (low, middle) if proximity.look(groups, middle).failing else (middle, high)
        return low

    group = min((g for g in proximity.alone["fr"] if len(g.pairs) > 2), key=proximity.least)
    pairs = [proximity.pair(group, index) for index in range(len(group.pairs))]
    assert room([group]) == pytest.approx(min(room([pair]) for pair in pairs), abs=COAL_M)
    assert room([group]) > proximity.least(group) - group.stop_distance_m + 1e-3


def test_omitted_pairs_are_omitted_in_every_query_and_can_be_restored(proximity):
    for name, q in HOMES.items():
        proximity.place(name, q, STILL[name])
    one, other = "gr/link_3", "fr/link_1"

    def looked_at():
        groups = [*proximity.between["fr", "gr"], *proximity.between["gr", "fr"]]
        for group in groups:
            proximity.least(group)
        return sum({one, other} == set(near.pair) for g in groups for near in g.measured().values())

    assert looked_at() == 2
    proximity.leave_out([(one, other)])
    assert looked_at() == 0
    proximity.leave_out([(other, one)], left_out=False)
    assert looked_at() == 2


def test_with_every_pair_omitted_a_query_finds_nothing(proximity):
    groups = proximity.between["fr", "gr"]
    for name, q in HOMES.items():
        proximity.place(name, q, STILL[name])
    proximity.leave_out((one.name, other.name) for group in groups for one, other in group.pairs)
    look = proximity.look(groups, 100.0)
    assert (look.failing, look.too_near, look.tightest, look.stop_distance_m) == ([], False, None, 0.0)


@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_an_approach_gives_the_change_of_a_distance_by_each_joint(proximity, robot):
    q, _ = drawn(8)
    for name in q:
        proximity.place(name, q[name], STILL[name])
    other = "gr" if robot == "fr" else "fr"
    for groups, distance_m in ((proximity.alone[robot], 0.5), (proximity.between[robot, other], 2.0)):
        found = proximity.approaches(robot, groups, distance_m)
        assert len(found) >= 3
        for approach in found[:3]:
            group, index = next(
                (g, i)
                for g in groups
                for i, pair in enumerate(g.pairs)
                if (pair[0].name, pair[1].name) == approach.pair
            )
            pair = proximity.pair(group, index)
            assert approach.stop_distance_m == group.stop_distance_m
            for joint in range(q[robot].size):
                moved = q[robot] + 1e-5 * (np.arange(q[robot].size) == joint)
                proximity.place(robot, moved, STILL[robot])
                lost = (approach.distance_m - proximity.least(pair)) / 1e-5
                assert approach.per_joint[joint] == pytest.approx(lost, abs=0.15)
            proximity.place(robot, q[robot], STILL[robot])


ASK = """
import json, sys
import coal, numpy as np, pinocchio as pin
from deltaq_cell.group import make_reproducible

def distance():
    geometry = pin.GeometryModel()
    for name, size, place in (("low", (0.2, 6.18, 0.161), (1.335, 0.0085, 0.0695)),
                              ("high", (1.285, 0.25, 0.3), (0.7995, -3.155, 0.392))):
        placement = pin.SE3(np.eye(3), np.array(place))
        geometry.addGeometryObject(pin.GeometryObject(name, 0, placement, coal.Box(*size)))
    geometry.addCollisionPair(pin.CollisionPair(0, 1))
    model, data = pin.Model(), geometry.createData()
    make_reproducible(data)
    pin.updateGeometryPlacements(model, model.createData(), geometry, data, np.zeros(0))
    return pin.computeDistance(geometry, data, 0).min_distance

first = distance()
if sys.argv[1] == "a cell":
    from deltaq_cell.cell_model import CellModel
    from deltaq_cell.compiled_proximity import CompiledProximity
    CompiledProximity(CellModel.load("lab"))
print(json.dumps([first, distance()]))
"""


@pytest.mark.long
@pytest.mark.parametrize("before", ["nothing", "a cell"])
def test_boxes_have_their_size_independent_of_the_first_query(before):
    done = ran([sys.executable, "-W", "ignore", "-c", ASK, before])
    assert json.loads(done.stdout) == [pytest.approx(0.092, abs=1e-15)] * 2
