"""Hulls that measure alike whatever was measured before, and that hold all of their mesh."""

import coal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_cell.cell_model import CellModel
from deltaq_cell.hull import MOST_CORNERS, Corners, HullError, hull_corners, hull_shape

WEDGE = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def hull_of(points):
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(point)
    return coal.Convex.convexHull(corners, True, "Qt")


def on_a_ball(count, seed=1, scale=(1.0, 1.0, 1.0)):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None] * scale


def beyond(points, corners: Corners) -> float:
    """How far any of the points lies outside the hull of the corners [m]."""
    hull, places = hull_shape(corners), np.array(corners)
    faces = np.array([[hull.polygons(i)[j] for j in range(3)] for i in range(hull.num_polygons)])
    a, b, c = places[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    kept = np.linalg.norm(normals, axis=1) > 1e-12
    normals = normals[kept] / np.linalg.norm(normals[kept], axis=1)[:, None]
    normals *= np.sign(np.einsum("ij,ij->i", normals, a[kept] - places.mean(axis=0)))[:, None]
    offsets = np.einsum("ij,ij->i", normals, a[kept])
    return float((points @ normals.T - offsets).max())


def distance(hull, point) -> float:
    ball = coal.Transform3s(np.eye(3), np.array(point))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(hull, coal.Transform3s(), coal.Sphere(0.01), ball, request, result)


def test_a_small_hull_keeps_its_corners_and_their_order():
    hull = hull_of(on_a_ball(20))
    corners = [tuple(hull.point(index)) for index in range(hull.num_points)]
    assert list(hull_corners(on_a_ball(20))) == corners


def test_a_hull_rebuilt_from_its_corners_measures_bit_identically():
    original = hull_of(on_a_ball(20))
    told = hull_shape(hull_corners(on_a_ball(20)))
    for point in on_a_ball(200, seed=2) * 1.5:
        assert distance(told, point).hex() == distance(original, point).hex()


@pytest.mark.long
@given(
    count=st.integers(5, 400),
    seed=st.integers(0, 10_000),
    scale=st.tuples(*[st.floats(0.003, 3.0)] * 3),
    off=st.tuples(*[st.floats(-2.0, 2.0)] * 3),
)
def test_every_point_of_a_mesh_is_inside_its_hull(count, seed, scale, off):
    points = on_a_ball(count, seed, scale) + off
    corners = hull_corners(points)
    assert len(corners) <= MOST_CORNERS
    assert beyond(points, corners) <= 1e-9


def test_a_hull_around_a_ball_is_not_much_larger_than_the_ball():
    corners = hull_corners(on_a_ball(1000))
    assert np.linalg.norm(corners, axis=1).max() < 1.35


def test_a_hull_around_a_long_slanted_tube_follows_it():
    angle = np.linspace(0, 2 * np.pi, 60)
    ring = np.stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), np.zeros(60)], axis=1)
    turn = np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    tube = np.vstack([ring, ring + np.array([0, 0, 1.0])]) @ turn.T
    assert beyond(tube, hull_corners(tube)) <= 1e-9
    assert hull_shape(hull_corners(tube)).computeVolume() < 1.2 * hull_of(tube).computeVolume()


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((5, 3)), "lie in a plane; give the body a thickness"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], "4 points that lie in a plane"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1e-9]], "lie in a plane"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], "lie in a plane"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, np.nan]], "four, and finite numbers"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "3 points: it takes four"),
    ],
)
def test_points_that_span_no_volume_are_refused(points, message):
    with pytest.raises(HullError, match=message):
        hull_corners(np.array(points, dtype=float))


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        (tuple(map(tuple, on_a_ball(257).tolist())), "257 corners, must have at most 256"),
        ((*WEDGE, (0.1, 0.1, 0.1)), "of 5 corners of a hull only 4 are on its outside"),
        ((*WEDGE, WEDGE[0]), "of 5 corners of a hull only 4"),
        (WEDGE[:3], "it takes four"),
    ],
)
def test_given_corners_that_span_no_volume_are_refused(corners, message):
    with pytest.raises(HullError, match=message):
        hull_shape(corners)


def test_no_shipped_hull_needs_the_hill_climbing_of_coal():
    for robot in CellModel.load("lab").robots.values():
        for body in robot.geometry.geometryObjects:
            assert getattr(body.geometry, "num_points", 0) <= MOST_CORNERS, body.name
