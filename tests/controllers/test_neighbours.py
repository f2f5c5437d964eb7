"""Distances to what is near, and how the joints change them."""

import numpy as np
import pytest
from closed_loop import lab

from deltaq_controllers.surroundings.neighbours import Neighbours


def configurations(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return np.concatenate(
        [robot.home + random.uniform(-0.3, 0.3, robot.n) for robot in lab().robots.values()]
    )


@pytest.mark.parametrize("seed", range(6))
def test_rows_are_the_derivatives_of_the_distances(seed: int) -> None:
    neighbours = Neighbours(lab(), "fr", most=6)
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


@pytest.mark.long
def test_omitted_pairs_are_measured_in_time() -> None:
    patient = Neighbours(lab(), "fr")
    ranges = np.full(len(patient.names), 0.4)
    start, end = configurations(0), configurations(3)
    start[0] -= 1.0
    seen = 0
    for share in np.linspace(0.0, 1.0, 60):
        q = start + share * (end - start)
        # one that knows nothing yet leaves only out what the spheres keep apart
        ours, theirs = patient.near(q, ranges), Neighbours(lab(), "fr").near(q, ranges)
        np.testing.assert_array_equal(ours.pairs, theirs.pairs)
        np.testing.assert_array_equal(ours.distance, theirs.distance)
        np.testing.assert_array_equal(ours.own, theirs.own)
        seen += len(ours.pairs)
    assert seen > 60


def test_after_a_jump_of_a_robot_every_near_pair_is_measured() -> None:
    patient = Neighbours(lab(), "fr")
    ranges = np.full(len(patient.names), 0.6)
    for seed in range(20):
        q = configurations(seed)
        np.testing.assert_array_equal(
            patient.near(q, ranges).distance, Neighbours(lab(), "fr").near(q, ranges).distance
        )


def test_distant_bodies_do_not_displace_near_ones() -> None:
    few, all_of = Neighbours(lab(), "fr", most=4), Neighbours(lab(), "fr", most=1000)
    ranges = np.where(few.foreign, 3.0, 0.3)
    kinds: set[bool] = set()
    for seed in range(8):
        q = configurations(seed)
        ours, every = few.near(q, ranges), all_of.near(q, ranges)
        shares = np.sort(every.distance / ranges[every.pairs])
        np.testing.assert_allclose(ours.distance / ranges[ours.pairs], shares[:4])
        kinds |= set(few.foreign[ours.pairs].tolist())
    assert kinds == {True, False}


def test_neighbouring_links_are_no_pair() -> None:
    neighbours = Neighbours(lab(), "fr", most=40)
    near = neighbours.near(configurations(1), np.full(len(neighbours.names), 0.5))
    names = {frozenset(neighbours.names[pair]) for pair in near.pairs}
    assert frozenset(("fr/link_2", "fr/link_3")) not in names
    assert names
