"""Hulls that measure alike whatever was measured before."""

import coal
import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.hull import MOST_CORNERS, around, reproducible_hull


def hull_of(points):
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(point)
    return coal.Convex.convexHull(corners, True, "Qt")


def on_a_ball(count):
    points = np.random.default_rng(1).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def test_a_small_hull_stays_as_it_is():
    hull = hull_of(on_a_ball(20))
    assert reproducible_hull(hull) is hull


def test_a_large_hull_is_replaced_by_a_small_one_around_it():
    points = on_a_ball(300)
    hull = reproducible_hull(hull_of(points))
    assert hull.num_points <= 24
    for point in points:
        distance = coal.distance(
            hull, coal.Transform3s(), coal.Sphere(1e-6), coal.Transform3s(np.eye(3), point),
            coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        assert distance <= 1e-9


def test_the_corners_of_a_box_are_found():
    box = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 1.0) for z in (-1.0, 1.0)])
    corners = around(box)
    assert np.all(corners.min(axis=0) >= box.min(axis=0) - 1e-9)
    assert np.all(corners.max(axis=0) <= box.max(axis=0) + 1e-9)


def test_no_shipped_robot_has_a_hull_that_coal_walks_along():
    for robot in CellModel.load("lab").robots.values():
        for body in robot.geometry.geometryObjects:
            assert getattr(body.geometry, "num_points", 0) <= MOST_CORNERS, body.name
