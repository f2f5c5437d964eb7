"""A strip holds all points that it was made for, and is no wider than they ask for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltaq_cell.kernel.strip import strip_around


def in_numpy(points):
    """The same as arrays have it."""
    low, high = points.min(axis=0), points.max(axis=0)
    widest = np.argmax(high - low)
    start, end = points[np.argmin(points[:, widest])], points[np.argmax(points[:, widest])]
    middle, direction = (start + end) / 2, (end - start) / 2
    length = direction @ direction
    if length == 0.0:
        return middle, direction, np.zeros_like(direction)
    t = np.clip((points - middle) @ direction / length, -1.0, 1.0)
    aside = points - middle - t[:, None] * direction
    low, high = aside.min(axis=0), aside.max(axis=0)
    return middle + (low + high) / 2, direction, (high - low) / 2


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 17))
def test_the_points_lie_within_and_the_strip_is_what_arrays_say(seed, count, joints):
    random = np.random.default_rng(seed)
    steps = random.normal(size=joints) + random.normal(size=(count, joints)) * random.choice([0.0, 1e-3, 1.0])
    points = np.cumsum(steps * 10.0 ** random.uniform(-9, 0), axis=0) + random.normal(size=joints)
    middle, direction, deviation = strip_around(points)
    for found, expected in zip((middle, direction, deviation), in_numpy(points), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-13)
    along = np.abs(direction) > 0.0
    for point in points:
        # where each joint has the point within its deviation, from t to t
        beside = np.stack([point - middle - deviation - 1e-12, point - middle + deviation + 1e-12])
        at = np.sort(beside[:, along] / direction[along], axis=0)
        assert max([-1.0, *at[0]]) <= min([1.0, *at[1]])
        assert np.all(beside[0, ~along] <= 0.0)
        assert np.all(beside[1, ~along] >= 0.0)
    assert np.all(deviation >= 0.0)


def test_points_of_one_place_make_a_strip_of_no_size():
    middle, direction, deviation = strip_around(np.tile([1.0, -2.0], (5, 1)))
    assert middle.tolist() == [1.0, -2.0]
    assert direction.tolist() == deviation.tolist() == [0.0, 0.0]


def test_one_point_is_its_own_strip():
    assert strip_around(np.array([[0.5]]))[0].tolist() == [0.5]


@pytest.mark.parametrize("order", [1, -1])
def test_a_corner_lies_beside_the_way_from_end_to_end(order):
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]])[::order]
    middle, direction, deviation = strip_around(np.ascontiguousarray(points))
    assert np.abs(direction).tolist() == [1.0, 0.5]
    assert deviation.max() == pytest.approx(0.2)
    assert middle == pytest.approx([1.1, 0.3])
