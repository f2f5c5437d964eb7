"""Planes: what they are said to keep apart over a span of joint space stays apart at every sample of it."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spans import draw_span

from deltaq_cell.bodies import Extents
from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.robot_bodies import structure_geometry


@pytest.fixture(scope="module", params=["lab", "dawm"])
def cell(request):
    return CellModel.load(request.param)


@pytest.fixture(scope="module")
def proximity(cell):
    return CompiledProximity(cell)


def configuration(robot, random):
    near_home = robot.home + random.uniform(-1, 1, robot.n) * 0.3 * (robot.upper - robot.lower)
    return np.clip(near_home, robot.lower, robot.upper)


def span(robot, random):
    """Middle and span, anywhere near home."""
    return configuration(robot, random), *draw_span(robot.n, random)


def inside(middle, half, offsets, deviation, random, at):
    """A sample at a vertex, or anywhere between some, and mostly in a corner of what the span is wide."""
    share = np.eye(len(offsets))[at % len(offsets)] if at >= 0 else random.dirichlet(np.ones(len(offsets)))
    aside = (
        np.sign(random.normal(size=middle.size))
        if random.uniform() < 0.8
        else random.uniform(-1, 1, middle.size)
    )
    return middle + share @ offsets + aside * deviation


def greatest_room(proximity, group):
    """The most that a look shows of a group where the robots are placed [m]."""
    low, high = -1.0, 1.0
    for _ in range(14):
        middle = (low + high) / 2
        low, high = (low, middle) if proximity.look([group], middle).failing else (middle, high)
    return low


@pytest.mark.by_day(2)
@pytest.mark.long
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1))
def test_no_sample_of_a_span_is_nearer_than_the_query_says(cell, proximity, seed):
    random = np.random.default_rng(seed)
    spans = {name: span(robot, random) for name, robot in cell.robots.items()}
    for name, where in spans.items():
        proximity.place(name, *where)
    groups = [g for groups in (*proximity.alone.values(), *proximity.between.values()) for g in groups]
    some = [groups[index] for index in random.choice(len(groups), 12)]
    shown = [greatest_room(proximity, group) for group in some]
    swept = [proximity.least(group) - group.stop_distance_m for group in some]
    # those that inflated bodies show are another test's
    by_planes = [item for item in zip(some, shown, swept, strict=True) if item[1] > item[2] + 1e-3]
    for sample in range(24):
        for name, where in spans.items():
            # the first with all robots at the same vertices, then each anywhere
            q = inside(*where, random, sample if sample < 12 else int(random.integers(-2, 4)))
            proximity.place(name, q, np.zeros_like(q))
        for group, room, _ in by_planes:
            assert proximity.least(group) >= group.stop_distance_m + room - 1e-6, sample


@pytest.mark.by_day(2)
@pytest.mark.long
def test_planes_clear_pairs_that_inflated_bodies_cannot(cell, proximity):
    """Or the test above would hold for want of anything to judge."""
    random = np.random.default_rng(0)
    shown = []
    for _ in range(5):
        for name, robot in cell.robots.items():
            proximity.place(name, *span(robot, random))
        for group in proximity.alone[name][::5]:
            swept = proximity.least(group) - group.stop_distance_m
            shown.append(greatest_room(proximity, group) > swept + 1e-3)
    assert np.mean(shown) > 0.1


def test_sliding_along_a_body_costs_no_clearance(proximity, cell):
    """A prismatic joint that moves a robot past the floor brings it no nearer, however far it goes."""
    name = next(iter(cell.robots))
    robot = cell.robots[name]
    half = np.zeros(robot.n)
    proximity.place(name, robot.home, half)
    floor = [g for g in proximity.alone[name] if any("floor" in other.name for _, other in g.pairs)]
    spins = np.zeros(robot.n)
    spins[0] = 0.05  # the first joint of every robot here turns about the vertical, or slides level
    room = min(proximity.least(group) - group.stop_distance_m for group in floor)
    proximity.place(name, robot.home, np.abs(spins), np.array([-spins, spins]), half)
    assert proximity.look(floor, room - 0.02).failing == []


def test_an_extent_reaches_as_far_as_the_shape_it_describes(cell):
    random = np.random.default_rng(1)
    bodies = structure_geometry(cell.description)
    extents = Extents(bodies)
    for index, body in enumerate(bodies):
        body.geometry.computeLocalAABB()
        for _ in range(10):
            n = random.normal(size=3)
            n /= np.linalg.norm(n)
            across = np.linalg.norm(np.cross(n, extents.axis[index]))
            reach = (extents.corners[index] @ n).max() + extents.disc[index] * across + extents.ball[index]
            box = body.geometry.aabb_local
            centre = body.placement.act(np.array(box.center()))
            assert reach >= centre @ n
            assert reach - centre @ n <= np.linalg.norm(np.array(box.max_) - np.array(box.min_)) / 2 + 1e-9
