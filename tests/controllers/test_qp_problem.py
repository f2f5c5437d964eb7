"""The quadratic programme by itself: it always has an answer, and the answer keeps its order."""

import numpy as np
import pytest

from deltaq_controllers.camera.qp_problem import QuadraticProgram, Tasks
from deltaq_controllers.surroundings.barriers import Barriers

N = 6
NONE = Barriers(np.zeros((0, N)), np.zeros(0), np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp))
FIRST = np.zeros(1, dtype=np.intp)


def program() -> QuadraticProgram:
    return QuadraticProgram(np.full(N, 1e-3), rest_weight=1e-5, prices=(1e6, 1e7))


def test_a_task_within_the_bounds_is_met_exactly() -> None:
    row, wide = np.eye(N)[:1], np.full(N, 0.01)
    solution = program().solve(Tasks(row, np.array([2e-3]), np.ones(1)), -wide, wide, NONE)
    assert solution is not None
    assert solution[0][0] == pytest.approx(2e-3, rel=1e-3)
    assert np.abs(solution[0][1:]).max() < 1e-6


def test_bounds_outweigh_every_task_and_every_barrier() -> None:
    row, narrow = np.eye(N)[:1], np.full(N, 1e-3)
    barrier, least = np.eye(N)[:1], np.array([0.05])
    solution = program().solve(
        Tasks(row, np.array([-0.05]), np.ones(1)), -narrow, narrow, Barriers(barrier, least, FIRST, FIRST)
    )
    assert solution is not None
    dq, slack = solution
    assert (np.abs(dq) <= 1e-3).all()
    assert dq[0] == pytest.approx(1e-3, abs=1e-6), "as far as the barrier asks, not the task"
    assert slack == pytest.approx([0.049, 0.0], abs=1e-4)


def test_a_relaxed_barrier_does_not_relax_barriers_of_another_kind() -> None:
    barriers, wide = np.array([np.eye(N)[0], -np.eye(N)[0]]), np.full(N, 0.01)
    kinds = np.array([0, 1], dtype=np.intp)
    least = np.array([5e-3, -1e-3])
    solution = program().solve(
        Tasks(barriers[:1], np.zeros(1), np.ones(1)),
        -wide,
        wide,
        Barriers(barriers, least, kinds, np.arange(len(least))),
    )
    assert solution is not None
    assert solution[0][0] == pytest.approx(1e-3, abs=1e-5)
    assert solution[1] == pytest.approx([4e-3, 0.0], abs=1e-5)


def test_the_task_with_the_larger_weight_is_met_first() -> None:
    rows, wide = np.array([np.eye(N)[0], np.eye(N)[0]]), np.full(N, 0.01)
    wanted, weights = np.array([2e-3, -2e-3]), np.array([1.0, 1e-2])
    solution = program().solve(Tasks(rows, wanted, weights), -wide, wide, NONE)
    assert solution is not None
    assert solution[0][0] == pytest.approx(2e-3 * (1 - 1e-2) / (1 + 1e-2), rel=1e-2)


@pytest.mark.parametrize("seed", range(5))
def test_there_is_always_a_solution_within_the_bounds(seed: int) -> None:
    random, solver = np.random.default_rng(seed), program()
    for _ in range(60):
        rows, barriers = random.normal(size=(4, N)), random.normal(size=(random.integers(0, 5), N))
        centre = random.normal(scale=2e-3, size=N)
        slowest, fastest = centre - random.uniform(0, 2e-3, N), centre + random.uniform(0, 2e-3, N)
        solution = solver.solve(
            Tasks(rows, random.normal(scale=0.01, size=4), 10.0 ** random.uniform(-4, 0, 4)),
            slowest,
            fastest,
            Barriers(
                barriers,
                random.normal(scale=0.05, size=len(barriers)),
                random.integers(0, 2, len(barriers)),
                np.arange(len(barriers)),
            ),
        )
        assert solution is not None
        dq, slack = solution
        assert (dq >= slowest).all()
        assert (dq <= fastest).all()
        assert (slack >= 0.0).all()
