"""The kernel's screen by tight boxes: never more than the distance, and exact where boxes face one another."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_kernel_gap import coal_m, measured, two_bodies
from uncompiled import uncompiled

from deltaq_cell.anatomy import anatomy_of, oriented_box, placed_at_first
from deltaq_cell.bodies import Extents

apart = uncompiled("look").apart


def told_apart(objects):
    cell = anatomy_of(pin.Model(), objects, [])
    return apart(cell, placed_at_first(cell), 0, 1)


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_more_than_the_distance_is_told_and_a_unit_vector_from_one_to_the_other(seed):
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
def test_bodies_that_face_one_another_are_as_far_apart_as_they_are(shape, axis, sign):
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
def test_a_body_reaches_as_far_as_its_box_along_the_boxs_edges(seed):
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
