"""Distances to what is near, and how the joints change them."""

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab

from deltaq_controllers.camera.neighbours import Neighbours


def configurations(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return np.concatenate(
        [robot.home + random.uniform(-0.3, 0.3, robot.n) for robot in lab().robots.values()]
    )


@pytest.mark.parametrize("seed", range(6))
def test_rows_are_the_derivatives_of_the_distances(seed: int) -> None:
    neighbours = Neighbours(lab(), "fr", 0.0, most=6)
    q, ranges = configurations(seed), np.full(len(neighbours.names), 3.0)
    near = neighbours.near(q, ranges)
    assert len(near.pairs) == 6
    n, step = near.own.shape[1], 1e-4  # well above what GJK leaves of a distance
    for joint in range(len(q)):
        moved = q.copy()
        moved[joint] += step
        there = neighbours.near(moved, ranges)
        after = dict(zip(there.pairs, there.distance, strict=True))
        for row, pair in enumerate(near.pairs):
            if pair in after:
                expected = (after[pair] - near.distance[row]) / step
                got = near.own[row, joint] if joint < n else near.others[row, joint]
                assert got == pytest.approx(expected, abs=2e-2)


def test_pairs_that_sleep_are_awake_in_time() -> None:
    ranges_m, steps = 0.4, 150
    patient, thorough = Neighbours(lab(), "fr", CYCLE_S), Neighbours(lab(), "fr", 0.0)
    ranges = np.full(len(patient.names), ranges_m)
    start, end = configurations(0), configurations(3)
    start[0] -= 1.0
    seen = 0
    for share in np.linspace(0.0, 1.0, steps):
        q = start + share * (end - start)
        ours, theirs = patient.near(q, ranges), thorough.near(q, ranges)
        assert ours.distance == pytest.approx(theirs.distance)
        assert set(ours.pairs) == set(theirs.pairs)
        seen += len(ours.pairs)
    assert seen > steps


def test_neighbouring_links_are_no_pair() -> None:
    neighbours = Neighbours(lab(), "fr", 0.0, most=40)
    near = neighbours.near(configurations(1), np.full(len(neighbours.names), 0.5))
    names = {frozenset(neighbours.names[pair]) for pair in near.pairs}
    assert frozenset(("fr/link_2", "fr/link_3")) not in names
    assert names
