"""Convex parts of a mesh: together they hold all of it, and they are nearer to it than its hull."""

from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_cell import convex_parts as parts
from deltaq_cell.hull import HullError, convex_hull, faces_of, hull_shape, points_of
from deltaq_cell.models import load_urdf
from deltaq_cell.urdf_parsing import parse_geometry

ROBOTS = "package://example-robot-data/robots"
NARROW_M = 1e-9


def box(low, high):
    """(12, 3, 3) triangles of a box."""
    hull = convex_hull(np.array(list(product(*zip(low, high, strict=True))), dtype=float))
    return points_of(hull)[np.array(faces_of(hull))]


LEVER = np.concatenate([box((0, 0, 0), (1, 0.2, 0.2)), box((0, 0, 0), (0.2, 0.2, 1))])
"""A bent link of two boxes."""


def held(points, bodies):
    """(k,) whether points are in one of some convex bodies."""
    found = np.zeros(len(points), dtype=bool)
    for corners in bodies:
        hull = convex_hull(np.array(corners))
        a, b, c = points_of(hull)[np.array(faces_of(hull))].transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1)
        kept = length > 1e-9 * length.max()
        normals, a = normals[kept] / length[kept][:, None], a[kept]
        normals *= np.sign(np.einsum("ij,ij->i", normals, a - np.mean(corners, axis=0)))[:, None]
        found |= (points @ normals.T <= np.einsum("ij,ij->i", normals, a) + NARROW_M).all(axis=1)
    return found


def on_surface(triangles, count, seed=0):
    """(count, 3) points of a mesh: corners, edges and faces."""
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.full(3, 0.5), count) * (rng.random((count, 3)) < 0.8)
    shares[shares.sum(axis=1) == 0.0] = 1.0
    shares /= shares.sum(axis=1)[:, None]
    return np.einsum("ki,kij->kj", shares, triangles[rng.integers(len(triangles), size=count)])


def meshes(file):
    """Triangles of the collision meshes of a public robot."""
    geometry = parse_geometry(
        load_urdf(f"{ROBOTS}/{file}"), pin.GeometryType.COLLISION, pin.SE3.Identity(), {}
    )
    for body in geometry.geometryObjects:
        mesh = body.geometry
        if not hasattr(mesh, "buildConvexHull"):
            continue
        faces = [
            [int(mesh.tri_indices(face)[corner]) for corner in range(3)] for face in range(mesh.num_tris)
        ]
        yield np.array(mesh.vertices())[faces]


def volume_m3(bodies):
    return sum(hull_shape(corners).computeVolume() for corners in bodies)


def test_a_bent_link_is_held_by_parts_of_hardly_more_volume():
    bodies = parts.convex_parts(LEVER)
    assert 2 <= len(bodies) <= parts.MOST_PARTS
    assert held(on_surface(LEVER, 20_000), bodies).all()
    inside = np.random.default_rng(1).random((20_000, 3)) * (1, 0.2, 1)
    inside = inside[(inside[:, 0] < 0.2) | (inside[:, 2] < 0.2)]
    assert held(inside, bodies).all()
    assert volume_m3(bodies) < 0.08
    assert volume_m3([parts.close_hull(LEVER.reshape(-1, 3))]) > 0.13


@pytest.mark.parametrize(
    "file", ["ur_description/urdf/ur10_robot.urdf", "kinova_description/robots/kinova.urdf"]
)
def test_parts_of_public_meshes_hold_all_of_them(file):
    hull_m3 = parts_m3 = 0.0
    for number, triangles in enumerate(list(meshes(file))[2::3]):
        bodies = parts.convex_parts(triangles)
        assert len(bodies) <= parts.MOST_PARTS
        assert all(len(corners) <= parts.MOST_CORNERS for corners in bodies)
        assert held(triangles.reshape(-1, 3), bodies).all()
        assert held(on_surface(triangles, 4000, number), bodies).all()
        hull_m3 += convex_hull(triangles.reshape(-1, 3)).computeVolume()
        parts_m3 += volume_m3(bodies)
    assert parts_m3 < hull_m3


@given(st.integers(0, 10_000), st.floats(-1.0, 1.0))
def test_each_piece_lies_on_its_side_and_the_pieces_are_the_whole(seed, at):
    rng = np.random.default_rng(seed)
    triangles = rng.integers(-2, 3, (40, 3, 3)) / 2  # many corners lie in the plane
    normal = rng.normal(size=3) if seed % 2 else np.eye(3)[seed % 3]
    below, above = parts.clipped(triangles, normal, at)
    assert (below @ normal <= at + 1e-12).all()
    assert (above @ normal >= at - 1e-12).all()

    def area(pieces):
        a, b, c = pieces.transpose(1, 0, 2)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2

    assert area(below) + area(above) == pytest.approx(area(triangles))


def test_each_triangle_is_in_one_part_or_was_cut_into_pieces_that_are():
    links = list(meshes("ur_description/urdf/ur10_robot.urdf"))[2:4]
    for mesh in (LEVER, *links):
        for piece in parts.split(mesh, np.eye(3)):
            assert held(piece.reshape(-1, 3), [parts.close_hull(piece.reshape(-1, 3))]).all()


def test_a_hull_keeps_its_corners_or_is_held_closely():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(3000, 3))
    points *= np.array([0.06, 0.06, 0.2]) / np.linalg.norm(points, axis=1)[:, None]
    few = points[:100]
    assert {tuple(corner) for corner in parts.close_hull(few)} <= set(map(tuple, few.tolist()))
    corners = parts.close_hull(points)
    assert len(corners) <= parts.MOST_CORNERS
    assert held(points, [corners]).all()
    assert volume_m3([corners]) < 1.05 * convex_hull(points).computeVolume()


def test_a_cone_with_a_fine_tip_has_a_hull():
    angles = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    cone = np.vstack([np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) * 0.1, [[0, 0, 0.3]]])
    corners = parts.close_hull(cone)
    assert len(corners) <= parts.MOST_CORNERS
    assert held(cone, [corners]).all()


def test_a_flat_mesh_has_no_parts():
    with pytest.raises(HullError, match="lie in a plane"):
        parts.convex_parts(LEVER * (1, 0, 1))


def test_an_open_mesh_that_a_cut_would_leave_flat_stays_whole_or_is_held():
    sheets = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 0, 1], [1, 0, 0]]], dtype=float)
    bodies = parts.convex_parts(sheets)
    assert held(on_surface(sheets, 2000), bodies).all()
