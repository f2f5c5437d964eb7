"""The kernel's distances: what it says from below and from above holds for every kind of body, however they lie."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from uncompiled import uncompiled

from deltaq_cell.anatomy import anatomy_of, oriented_box, placed_at_first
from deltaq_cell.bodies import Extents
from deltaq_cell.hull import hull_corners, hull_shape
from deltaq_cell.kernel.arrays import PlacedBody
from deltaq_cell.kernel.gap import ROUNDING_M

body_at, farthest, gap = (getattr(uncompiled("gap"), name) for name in ("body_at", "farthest", "gap"))
towards_origin = uncompiled("gap").towards_origin
KINDS = ("box", "sphere", "capsule", "cylinder", "hull")


def coal_m(distance):
    """What coal's iterations may be off: they end at a share of the distance."""
    return 2e-6 * (1.0 + abs(distance))


def shape(kind, random):
    size = 10.0 ** random.uniform(-2, 0.5, 3)
    if kind == "box":
        return coal.Box(*size)
    if kind == "sphere":
        return coal.Sphere(size[0])
    if kind in ("capsule", "cylinder"):
        return (coal.Capsule if kind == "capsule" else coal.Cylinder)(size[0], size[1])
    return hull_shape(hull_corners(random.normal(size=(12, 3)) * size.mean()))


def two_bodies(random, apart_m, kinds=None):
    """Two bodies as the kernel has them, and what coal needs of them."""
    objects = []
    for index in range(2):
        kind = kinds[index] if kinds else random.choice(KINDS)
        rotation = (
            pin.Quaternion(*random.normal(size=4)).normalized().matrix()
            if random.uniform() < 0.8
            else np.eye(3)
        )
        place = pin.SE3(rotation, random.normal(size=3) * apart_m)
        objects.append(pin.GeometryObject(f"structure/{index}", 0, place, shape(kind, random)))
    cell = anatomy_of(pin.Model(), objects, [])
    placed = placed_at_first(cell)
    return objects, [body_at(cell, placed, index) for index in range(2)]


def measured(objects):
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    transforms = [coal.Transform3s(item.placement.rotation, item.placement.translation) for item in objects]
    coal.distance(objects[0].geometry, transforms[0], objects[1].geometry, transforms[1], request, result)
    return result.min_distance


def searched(bodies, enough_m=np.inf, towards=(1.0, 0.0, 0.0), asked_m=np.inf):
    return gap(*bodies, *towards, enough_m, asked_m, np.zeros((4, 3)))


@given(st.integers(0, 2**32 - 1), st.floats(4.0, 13.0))
def test_the_farthest_point_of_a_disc_lies_on_its_rim_also_along_its_axis(seed, decimals):
    random = np.random.default_rng(seed)
    _, (body, _) = two_bodies(random, 1.0, kinds=("cylinder", "box"))
    axis = np.array((body.axis_x, body.axis_y, body.axis_z))
    towards = axis + random.normal(size=3) * 10.0**-decimals
    point = np.array(farthest(body, *towards / np.linalg.norm(towards)))
    corners = body.corners[: body.corner_count]
    from_corner = point - corners[np.argmax(corners @ axis)]
    # a point beyond the body would make a bound from below too large
    assert abs(from_corner @ axis) < 1e-14 * (1.0 + np.abs(corners).max())
    assert np.linalg.norm(from_corner) <= body.disc * (1.0 + 1e-14) + 1e-14 * np.abs(corners).max()


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_distance_lies_between_the_bounds_and_they_meet(seed):
    random = np.random.default_rng(seed)
    objects, bodies = two_bodies(random, 10.0 ** random.uniform(-1, 1))
    distance = measured(objects)
    lower, upper, *normal = searched(bodies, towards=random.normal(size=3))
    assert lower <= max(distance, 0.0) + coal_m(distance)
    assert upper >= distance - coal_m(distance)
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
    if distance > 1e-5:
        assert upper - lower < 2e-6


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-0.5, 0.5))
def test_a_search_loses_at_most_a_hundredth_of_the_distance(seed, room):
    random = np.random.default_rng(seed)
    objects, bodies = two_bodies(random, 3.0)
    distance = measured(objects)
    lower, upper, *_ = searched(bodies, towards=random.normal(size=3), asked_m=distance - room)
    assert lower <= max(distance, 0.0) + coal_m(distance)
    assert upper >= distance - coal_m(distance)
    if distance > 1e-5:
        assert upper - lower <= max(2e-6, 0.01 * room)


@pytest.mark.parametrize("one", KINDS)
@pytest.mark.parametrize("other", KINDS)
def test_the_bounds_meet_at_what_coal_measures_for_every_two_kinds(one, other):
    random = np.random.default_rng(7)
    compared = 0
    for _ in range(12):
        objects, bodies = two_bodies(random, 4.0, (one, other))
        distance = measured(objects)
        lower, upper, *_ = searched(bodies)
        if distance > 1e-5:
            compared += 1
            assert lower == pytest.approx(distance, abs=coal_m(distance))
            assert upper == pytest.approx(distance, abs=coal_m(distance))
        else:
            assert lower <= coal_m(0.0)
    assert compared


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-0.5, 0.5))
def test_a_search_that_ends_early_never_overstates_the_distance(seed, beyond):
    random = np.random.default_rng(seed)
    objects, bodies = two_bodies(random, 3.0)
    distance = measured(objects)
    enough = distance + beyond
    lower, upper, *_ = searched(bodies, enough)
    if lower > enough:
        assert lower <= distance + coal_m(distance)
    else:
        assert upper < np.inf  # then it went on to the end
        assert upper >= distance - coal_m(distance)


def test_a_separating_plane_touches_neither_body():
    """A lower bound is what its own normal shows, whoever found it."""
    random = np.random.default_rng(3)
    for _ in range(100):
        _, bodies = two_bodies(random, 3.0)
        lower, _, x, y, z = searched(bodies)
        first = np.array(farthest(bodies[0], x, y, z)) @ (x, y, z) + bodies[0].ball
        second = np.array(farthest(bodies[1], -x, -y, -z)) @ (x, y, z) - bodies[1].ball
        assert lower == pytest.approx(second - first - ROUNDING_M, abs=1e-12)


def test_no_plane_separates_overlapping_bodies():
    random = np.random.default_rng(5)
    overlapping = 0
    for _ in range(200):
        objects, bodies = two_bodies(random, 0.3)
        if measured(objects) < -1e-4:
            overlapping += 1
            lower, upper, *_ = searched(bodies, random.uniform(-0.1, 0.1))
            assert lower <= ROUNDING_M
            assert upper < 1e-6 or upper == np.inf
    assert overlapping > 50


def point(*at):
    return PlacedBody(np.array([at], dtype=np.float64), 1, 0.0, 0.0, 1.0, 0.0, 0.0)


def test_a_zero_start_direction_gives_no_bound():
    lower, upper, *_ = searched((point(0, 0, 0), point(3, 0, 0)), towards=(0.0, 0.0, 0.0))
    assert (lower, upper) == (-np.inf, np.inf)


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_of_a_simplex_no_point_is_nearer_to_the_origin(seed, count):
    random = np.random.default_rng(seed)
    corners = random.normal(size=(count, 3)) + random.normal(size=3) * random.choice([0.0, 1.0, 5.0])
    simplex = np.zeros((4, 3))
    simplex[:count] = corners
    kept, *nearest = towards_origin(simplex, count, False)
    assert 1 <= kept <= count
    n = np.array(nearest)
    # of a convex set p is nearest to the origin if and only if all of it lies beyond the plane through p
    assert (corners @ n).min() >= n @ n - 1e-9 * max(1.0, np.abs(corners).max() ** 2)
    weights = np.linalg.lstsq(np.vstack([simplex[:kept].T, np.ones(kept)]), np.append(n, 1.0), rcond=None)[0]
    np.testing.assert_allclose(simplex[:kept].T @ weights, n, atol=1e-9)
    assert weights.min() > -1e-9


apart = uncompiled("look").apart


def told_apart(objects):
    cell = anatomy_of(pin.Model(), objects, [])
    return apart(cell, placed_at_first(cell), 0, 1)


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_answer_is_at_most_the_distance_with_a_unit_vector_between_the_bodies(seed):
    objects, _ = two_bodies(np.random.default_rng(seed), 3.0)
    free, *normal = told_apart(objects)
    assert free <= max(measured(objects), 0.0) + coal_m(measured(objects))
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-9)
    if free > 0.0:
        assert np.dot(normal, objects[1].placement.translation - objects[0].placement.translation) > 0.0


BOX = coal.Box(0.4, 0.2, 0.6)


@pytest.mark.parametrize(
    ("shape", "axis"),
    [(BOX, 0), (BOX, 1), (BOX, 2), (coal.Cylinder(0.1, 0.6), 2), (coal.Capsule(0.1, 0.4), 2)],
)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_facing_bodies_have_their_exact_distance(shape, axis, sign):
    turned = pin.Quaternion(0.3, -0.5, 0.7, 0.4).normalized().matrix()
    way = np.zeros(3)
    way[axis] = 2.0 * sign
    objects = [
        pin.GeometryObject("structure/0", 0, pin.SE3(turned, np.ones(3)), shape),
        pin.GeometryObject("structure/1", 0, pin.SE3(turned, np.ones(3) + turned @ way), shape),
    ]
    free, *normal = told_apart(objects)
    assert free == pytest.approx(measured(objects), abs=1e-6)
    np.testing.assert_allclose(normal, turned @ way / 2.0, atol=1e-9)


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_along_its_box_edges_a_body_reaches_as_far_as_its_box(seed):
    """The box holds the body, and touches it on every side."""
    objects, _ = two_bodies(np.random.default_rng(seed), 1.0)
    extents = Extents(objects[:1])
    corners, axis, disc, ball = (of[0] for of in (extents.corners, extents.axis, extents.disc, extents.ball))
    edges, centre, half = oriented_box(corners, axis, disc, ball)
    np.testing.assert_allclose(edges @ edges.T, np.eye(3), atol=1e-9)
    for edge, reach in zip(edges, half, strict=True):
        for side in (edge, -edge):
            farthest = (corners @ side).max() + disc * np.linalg.norm(np.cross(side, axis)) + ball
            assert farthest == pytest.approx(side @ centre + reach, abs=1e-9)
