"""A span holds all points that it was made for, and is no wider than they ask for."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spans import is_inside

from deltaq_cell.kernel.span import SHORTEST, VERTICES, off_hull, span_around, widths


def beside(points, start, end):
    """(m, n) how far the points between two lie beside the line from the one to the other."""
    between, way = points[start + 1 : end] - points[start], points[end] - points[start]
    length = way @ way
    t = np.clip(between @ way / length, 0.0, 1.0) if length else np.zeros(len(between))
    return between - t[:, None] * way


def in_numpy(points):
    """The same as arrays have it."""
    kept = [0, len(points) - 1]
    while len(kept) < VERTICES:
        lines = [np.abs(beside(points, *ends)).max(axis=1) for ends in pairwise(kept)]
        widest = max(range(len(lines)), key=lambda line: lines[line].max(initial=0.0))
        if lines[widest].max(initial=0.0) <= SHORTEST:
            break
        kept.insert(widest + 1, kept[widest] + 1 + int(lines[widest].argmax()))
    aside = np.vstack([0 * points[:1], *(beside(points, *ends) for ends in pairwise(kept))])
    low, high = aside.min(axis=0), aside.max(axis=0)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    if len(kept) == 2 and (points[0] == points[-1]).all():
        kept = kept[:1]
    return middle, np.ptp(points, axis=0) / 2, points[kept] + (low + high) / 2 - middle, (high - low) / 2


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 17))
def test_every_point_is_within_the_width_of_a_segment_and_the_span_agrees_with_numpy(seed, count, joints):
    random = np.random.default_rng(seed)
    steps = random.normal(size=joints) + random.normal(size=(count, joints)) * random.choice([0.0, 1e-3, 1.0])
    points = np.cumsum(steps * 10.0 ** random.uniform(-9, 0), axis=0) + random.normal(size=joints)
    middle, half, offsets, deviation = span_around(points)
    for found, expected in zip((middle, half, offsets, deviation), in_numpy(points), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-13)
    vertices = middle + offsets
    lines = list(pairwise(vertices)) or [(vertices[0], vertices[0])]
    for point in points:
        assert np.all(np.abs(point - middle) <= half + 1e-12)
        assert any(is_beside(point, start, end, deviation) for start, end in lines)


def is_beside(point, start, end, deviation):
    """Whether each joint has a point within the deviation of a line, from t to t."""
    way = end - start
    along = way != 0.0
    at = np.sort(
        np.stack([point - start - deviation - 1e-12, point - start + deviation + 1e-12])[:, along]
        / way[along],
        axis=0,
    )
    still = np.all(np.abs(point - start)[~along] <= deviation[~along] + 1e-12)
    return bool(still) and max([0.0, *at[0]]) <= min([1.0, *at[1]]) + 1e-9


def test_coincident_points_make_a_span_of_zero_size():
    middle, half, offsets, deviation = span_around(np.tile([1.0, -2.0], (5, 1)))
    assert middle.tolist() == [1.0, -2.0]
    assert half.tolist() == deviation.tolist() == [0.0, 0.0]
    assert offsets.tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("order", [1, -1])
def test_a_corner_of_a_trajectory_is_a_vertex(order):
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.5, 1.0], [3.0, 2.0]])[::order]
    middle, half, offsets, deviation = span_around(np.ascontiguousarray(points))
    np.testing.assert_allclose(middle + offsets, points[[0, 2, 4]], atol=1e-15)
    assert middle.tolist() == half.tolist() == [1.5, 1.0]
    np.testing.assert_allclose(deviation, 0.0, atol=1e-15)


def test_a_reversing_trajectory_has_a_vertex_where_it_reverses():
    points = np.array([[0.0], [1.0], [2.0], [1.0], [0.0]])
    assert (span_around(points)[0] + span_around(points)[2]).ravel().tolist() == [0.0, 2.0, 0.0]


def test_the_width_of_a_span_is_the_deviation_of_the_curve_from_its_segments():
    """Of an arc all points but its four vertices lie to one side of the lines between them."""
    t = np.linspace(0.0, 1.0, 40)
    points = np.stack([np.cos(t), np.sin(t)], axis=1)
    _, half, offsets, deviation = span_around(points)
    assert len(offsets) == VERTICES
    assert 0.0 < deviation.max() < 0.02
    np.testing.assert_allclose(half, [(1 - np.cos(1)) / 2, np.sin(1) / 2])


def test_the_width_is_the_tolerance_plus_the_lag_spread_times_the_fastest_step():
    points = np.array([[0.0, 1.0], [0.1, 1.0], [0.4, 0.8]])
    np.testing.assert_allclose(widths(points, np.array([0.01, 0.02]), 0.5), [0.16, 0.12])
    np.testing.assert_allclose(widths(points[:1], np.array([0.01, 0.02]), 0.5), [0.01, 0.02])


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 16), st.integers(1, 9))
def test_the_distance_from_a_hull_agrees_with_a_programme_beyond_the_width(seed, count, joints):
    random = np.random.default_rng(seed)
    points = np.cumsum(random.normal(size=(count, joints)), axis=0)
    width = random.uniform(0.01, 1.0, joints)
    q = random.dirichlet(np.full(count, 0.5)) @ points + random.normal(size=joints) * random.choice(
        [0.0, 0.3, 3.0]
    )
    off = np.abs(off_hull(points, q, width))
    if count == 1:
        np.testing.assert_allclose(off, np.abs(q - points[0]))
    # the search never says that a robot is on its hull that is not
    if (off <= width).all():
        assert is_inside(SimpleNamespace(middle=0.0, offsets=points, deviation=width), q, 1e-6)
    # and where it says that it is off, no point of the hull is nearer in squares of the width
    else:
        assert not is_inside(
            SimpleNamespace(middle=0.0, offsets=points, deviation=width / np.sqrt(joints)), q, -1e-6
        )
