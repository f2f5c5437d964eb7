"""The kernel against coal: nothing is left out that should not be. `test_planes.py` holds its planes alone."""

import os
import sys
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from own_robot import write_cell, write_package
from ran import ran
from spans import draw_span

from deltaq_cell import compiled_proximity
from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity, DistanceQuery
from deltaq_cell.group import Group
from deltaq_cell.kernel import look as kernel
from deltaq_cell.proximity import ProximityEngine
from deltaq_protocol.arrays import Array


class ReferenceProximity(ProximityEngine):
    """All bodies of a cell, placed in boxes of joint space and looked at in groups."""

    def place(
        self, robot: str, q: Array, half: Array, offsets: Array | None = None, deviation: Array | None = None
    ) -> float:
        """Place a robot in the box around a span, as `CompiledProximity.place` does."""
        del offsets, deviation  # which only planes ask for
        return super().place(robot, q, half)

    def look(self, groups: Sequence[Group], room_m: float) -> DistanceQuery:
        """The groups whose inflated bodies have less than `room_m` beyond their stop distance; see `CompiledProximity`.

        Groups fail here that planes keep apart.
        """
        rooms = {group: self.least(group) - group.stop_distance_m for group in groups if not group.is_empty}
        if not rooms:
            return DistanceQuery([], False, None, 0.0)
        failing = [group for group, room in rooms.items() if room < room_m]
        too_near = any(
            near.distance_m < group.stop_distance_m + room_m
            for group in failing
            for near in group.measured().values()
        )
        tightest = min(rooms, key=rooms.__getitem__)
        return DistanceQuery(failing, too_near, tightest.nearest(), tightest.stop_distance_m)


TOLERANCE_M = 2e-6
"""What the kernel's search and coal's may differ by."""


@pytest.fixture(scope="module", params=["lab", "dawm", "lab-4ms", "three robots"])
def cell(request, tmp_path_factory):
    if request.param != "three robots":
        return CellModel.load(request.param)
    folder = tmp_path_factory.mktemp("circle")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_PACKAGE_PATH", str(folder / "ws"))
        write_package(folder / "ws")
        return CellModel.load(write_cell(folder, robots=3))


@pytest.fixture(scope="module")
def reference(cell):
    return ReferenceProximity(cell)


@pytest.fixture(scope="module")
def proximity(cell):
    return CompiledProximity(cell)


def spans(cell, random):
    """Middle and span for each robot: at rest, along a line, between vertices, or a box; near home or anywhere."""
    drawn = {}
    for name, robot in cell.robots.items():
        spread = random.choice([0.1, 0.3, 1.0]) * random.uniform(-1, 1, robot.n)
        q = np.clip(robot.home + spread * (robot.upper - robot.lower), robot.lower, robot.upper)
        drawn[name] = q, *draw_span(robot.n, random, lengths=(-3, -0.2))
    return drawn


def placed(proximities, drawn):
    for proximity in proximities:
        for name, span in drawn.items():
            proximity.place(name, *span)


def lists(*proximities):
    """The groups of each list, in the one and the other."""
    for key in proximities[0].alone:
        yield tuple(item.alone[key] for item in proximities)
    for key in proximities[0].between:
        yield tuple(item.between[key] for item in proximities)


def seeded(examples):
    def decorated(test):
        quiet = [HealthCheck.function_scoped_fixture]
        return settings(max_examples=examples, deadline=None, suppress_health_check=quiet)(
            given(st.integers(0, 2**32 - 1))(test)
        )

    return decorated


def room_of(look):
    return look.tightest.swept_m - look.stop_distance_m


def names(groups):
    return {group.pairs[0][0].name + group.pairs[0][1].name for group in groups}


@pytest.mark.by_day(2)
@pytest.mark.long
@seeded(25)
def test_planes_only_remove_pairs_found_by_inflated_bodies(cell, reference, proximity, seed):
    random = np.random.default_rng(seed)
    placed((reference, proximity), spans(cell, random))
    room_m = float(random.choice([1e-5, 0.01, 0.1]))
    for readable, quick in lists(reference, proximity):
        if not readable:
            continue
        expected, found = reference.look(readable, room_m), proximity.look(quick, room_m)
        assert room_of(found) == pytest.approx(room_of(expected), abs=TOLERANCE_M)
        # where rounding decides, one of the two says what the other does for a little more or less
        more, less = (
            reference.look(readable, room_m + TOLERANCE_M),
            reference.look(readable, room_m - TOLERANCE_M),
        )
        assert found.too_near in (less.too_near, more.too_near)
        if more.too_near == less.too_near:
            assert names(found.failing) <= names(more.failing)
            assert not found.too_near or names(less.failing) <= names(found.failing)


@pytest.mark.long
@seeded(25)
def test_a_robot_is_placed_where_pinocchio_has_it(cell, reference, proximity, seed):
    drawn = spans(cell, np.random.default_rng(seed))
    for name, span in drawn.items():
        assert proximity.place(name, *span) == pytest.approx(reference.place(name, *span), abs=1e-12)
    where, J = proximity._where, np.reshape(reference._data.J, (6, -1))
    np.testing.assert_allclose(where.columns.T, J, atol=1e-12)
    for name, bodies in reference._bodies.items():
        first, last = proximity._ranges[name][1]
        theirs = bodies.corners_in_world(reference._data.oMi)
        moved = drawn[name][1] > 0.0
        arms = bodies.lever_arms(J[:, bodies.slice_q], theirs)[:, moved]
        np.testing.assert_allclose(where.arms[first:last, bodies.slice_q][:, moved], arms, atol=1e-12)
        for body, corners in zip(range(first, last), theirs, strict=True):
            count = proximity._anatomy.corner_count[body]
            np.testing.assert_allclose(where.corners[body, :count], corners[:count], atol=1e-12)
            assert {tuple(row) for row in corners} == {tuple(row) for row in corners[:count]}


@seeded(12)
def test_omitted_pairs_have_more_clearance_than_requested(cell, proximity, seed):
    """Every pair, as coal measures it: by balls, by boxes, and by the search that ends early."""
    random = np.random.default_rng(seed)
    drawn = spans(cell, random)
    placed((proximity,), drawn)
    room_m, tells = float(random.choice([1e-5, 0.05])), bool(random.integers(2))
    anatomy, where, found = proximity._anatomy, proximity._where, proximity._found
    for (listed,) in lists(proximity):
        if not listed:
            continue
        every = np.arange(len(listed.numbers))
        kernel._screen(anatomy, where, listed.pairs, every, True, found)
        by_balls = found.room_m[: len(listed.numbers)].copy()
        asked = anatomy, where, listed.pairs, every, room_m
        _, any_open, too_near, _ = kernel.look(*asked, True, tells, found)
        assert any_open == found.open[: len(listed.numbers)].any()
        if not too_near:
            kernel.separate_pairs(*asked, found)
        told = found.room_m[: len(listed.numbers)].copy()
        open_ = found.open[: len(listed.numbers)].copy()
        for index in random.choice(len(listed.numbers), min(40, len(listed.numbers)), replace=False):
            nearest, stop_m = proximity._measure(listed, int(index))
            room = nearest.swept_m - stop_m
            assert by_balls[index] <= room + TOLERANCE_M
            if not open_[index] and told[index] > room_m:
                assert room > room_m - TOLERANCE_M
            if too_near:
                assert open_[index] or room > room_m - TOLERANCE_M


def test_the_draws_above_are_of_every_kind(cell, proximity):
    random = np.random.default_rng(1)
    kinds = {"clear": 0, "open": 0} | ({} if len(cell.robots) == 3 else {"too near": 0})
    for _ in range(60):
        placed((proximity,), spans(cell, random))
        for (listed,) in lists(proximity):
            if listed:
                look = proximity.look(listed, 1e-5)
                kinds["too near" if look.too_near else "open" if look.failing else "clear"] += 1
    assert min(kinds.values()) > 0, kinds


def test_earlier_queries_do_not_change_a_bit_of_the_answer(cell, proximity):
    random = np.random.default_rng(5)
    drawn = spans(cell, random)

    def answers(by):
        placed((by,), drawn)
        looks = [by.look(listed, 1e-5) for (listed,) in lists(by) if listed]
        told = [(look.tightest.pair, look.tightest.swept_m.hex(), look.too_near) for look in looks]
        return told, [names(look.failing) for look in looks], by._found.room_m[:20].tobytes()

    first = answers(proximity)
    for _ in range(5):
        placed((proximity,), spans(cell, random))
        for (listed,) in lists(proximity):
            if listed:
                proximity.look(listed, float(random.uniform(0, 0.3)))
        assert answers(proximity) == first
    assert answers(CompiledProximity(cell)) == first


def test_failed_groups_can_be_checked_again(cell, proximity):
    random = np.random.default_rng(2)
    seen = 0
    for _ in range(30):
        placed((proximity,), spans(cell, random))
        for (listed,) in lists(proximity):
            failing = proximity.look(listed, 0.3).failing if listed else []
            if failing:
                seen += 1
                again = proximity.look(failing, 0.3)
                assert names(again.failing) == names(failing)
                assert failing.numbers[failing.pairs.active].tolist() == [
                    number
                    for group in failing
                    for number in range(
                        proximity._numbers[group], proximity._numbers[group] + len(group.pairs)
                    )
                ]
    assert seen


@pytest.mark.by_day(2)
def test_of_overlapping_bodies_the_deepest_pair_is_reported(reference, proximity, cell):
    random = np.random.default_rng(11)
    deep = 0
    for _ in range(60):
        placed((reference, proximity), spans(cell, random))
        for readable, quick in lists(reference, proximity):
            expected = reference.look(readable, 1e-5) if readable else None
            if expected is not None and expected.tightest.distance_m < -1e-3:
                deep += 1
                assert room_of(proximity.look(quick, 1e-5)) == pytest.approx(
                    room_of(expected), abs=TOLERANCE_M
                )
    assert deep or len(cell.robots) == 3  # the toy arms cannot reach one another's pedestals


LOOKS = """
import numpy as np
from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity

cell = CellModel.load("dawm")
proximity, random = CompiledProximity(cell), np.random.default_rng(4)
robot = cell.robots["dawm"]
for _ in range(4):
    q = np.clip(robot.home + random.uniform(-0.5, 0.5, robot.n), robot.lower, robot.upper)
    direction = random.uniform(-0.05, 0.05, robot.n)
    offsets = np.array([-direction, direction, 0.5 * direction[::-1]])
    half = np.abs(offsets).max(axis=0) + 0.002
    proximity.place("dawm", q, half, offsets, np.full(robot.n, 0.002))
    look = proximity.look(proximity.alone["dawm"], 0.02)
    print(look.too_near, *look.tightest.pair, *proximity._found.open.astype(int), *proximity._found.normal.ravel())
    points = np.array([q, q + direction, q + 2 * direction + 0.01])
    tube = proximity.whole_tube("dawm", points, 1, 0, 3, np.full(robot.n, 1e-3), 0.5)
    told = proximity.certify(tube, None, proximity.alone["dawm"], 0.001, 50)
    print(told.holds, *told.tightest.pair, told.left, told.tightest.swept_m)
"""


def run(**environment):
    return ran([sys.executable, "-c", LOOKS], env={**os.environ, **environment}).stdout.splitlines()


@pytest.mark.long
def test_the_machine_code_agrees_with_its_python():
    for machine, python in zip(run(), run(NUMBA_DISABLE_JIT="1"), strict=True):
        told, expected = machine.split(), python.split()
        assert told[:3] == expected[:3]
        np.testing.assert_allclose(np.array(told[3:], float), np.array(expected[3:], float), atol=1e-9)


def test_the_compiler_uses_no_fast_math():
    """Else sums would be ordered as the processor likes."""
    for function in (
        kernel.look,
        kernel.separate_pairs,
        compiled_proximity.place,
        compiled_proximity.certify,
    ):
        assert not getattr(function, "targetoptions", {}).get("fastmath")
