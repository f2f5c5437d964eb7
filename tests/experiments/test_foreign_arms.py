"""The studies of the gate alone: their checker sees bodies too near, and a public arm stays clear under attack."""

from dataclasses import replace

import numpy as np
import pytest

from deltaq import Box, Gate
from deltaq_experiments.bench.filter_scenes import Distances, FilterScene
from studies.foreign_arms import ARMS, ROBOTS, attack
from studies.foreign_scenes import CYCLE_S, STOP_M, timed_path

UR10 = f"{ROBOTS}/{ARMS['UR10'][0]}"


def test_the_checker_measures_meshes_and_refuses_what_is_too_near():
    q = np.array([0, -1.2, 1.2, -1.5, -1.5, 0])
    free = Gate.from_urdf(UR10, CYCLE_S, {"board": Box((1, 1, 0.1), at=(0.9, 0, -0.1))}, q)
    scene = replace(FilterScene.of(free, UR10), stop_distance_m=STOP_M)
    oracle = Distances(scene)
    assert oracle.clear(q, 0.0)
    gap = oracle.distance_m(q, "wrist_3_link", "board")
    raised = {"board": Box((1, 1, 0.1), at=(0.9, 0, -0.1 + gap - STOP_M / 2))}
    assert not Distances(replace(scene, obstacles=raised)).clear(q, 0.0)


def test_a_path_in_time_keeps_the_limits_and_ends_at_rest():
    path = [np.zeros(2), np.array([1.0, -0.2]), np.array([1.0, 0.4])]
    velocity, acceleration = np.array([1.0, 2.0]), np.array([5.0, 5.0])
    q = timed_path(path, velocity, acceleration)
    dq = np.diff(q, axis=0) / CYCLE_S
    np.testing.assert_allclose(q[-1], path[-1], atol=1e-12)
    assert (np.abs(dq) <= velocity * (1 + 1e-9)).all()
    assert (np.abs(np.diff(dq, axis=0)) <= acceleration * CYCLE_S * (1 + 1e-6)).all()


@pytest.mark.long
def test_a_public_arm_stays_clear_under_attack():
    found = attack(UR10, "", decisions=400, seed=3)
    assert (found["violations"], found["near_at_start"]) == (0, False)
    assert found["moved"] > 0.3
    assert found["outcomes"]["held"] > 0
