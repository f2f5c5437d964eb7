"""Local minima of the energy by its gradient, many starts at once.

The hands stay, so a free joint u takes the arm along: `J_arm dq_arm/du = -J_base`, and the energy's gradient over the
free joints is `dE/du + dE/dq_arm dq_arm/du`. Steps are quasi-Newton ones (BFGS), several lengths of each tried at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.criteria import Postures
from deltaq_protocol.arrays import Array, Flags, Indices

LENGTHS = np.array([1.0, 0.4, 0.1, 0.02])
"""Fractions of a step that are tried."""

DAMPING = 1e-6
"""Added to the squares of an arm's Jacobian, so that a singular arm gives no infinite rates."""

RADIUS = 0.4
"""Longest step at first [rad or m]."""


def reduced_gradient(problem: AdvisorProblem, q: Array) -> Array:
    """(N, m) gradient of the energy by the free joints, at configurations (N, n)."""
    postures = Postures(problem.data, q)
    by_joint = problem.energy.gradient(postures)
    base = problem.tracker.base
    gradient: Array = by_joint[:, base].copy()
    for hand, arm in enumerate(problem.tracker.arms):
        J = postures.jacobians[:, hand]
        J_arm, J_base = J[:, :, arm.joints], J[:, :, base]
        square = J_arm @ J_arm.transpose(0, 2, 1) + DAMPING * np.eye(6)
        # dE/dq_arm J_arm^-1 J_base, from the left
        pull = np.linalg.solve(square, (J_arm @ by_joint[:, arm.joints, None]))
        gradient -= (J_base.transpose(0, 2, 1) @ pull)[:, :, 0]
    return gradient


def descend(
    problem: AdvisorProblem,
    q: Array,
    energy: Array,
    generator: np.random.Generator,
    steps: int,
    accept: Callable[[Indices, Array], Flags] | None = None,
) -> tuple[Array, Array]:
    """Descend from configurations, each on its branch.

    Beside the quasi-Newton step a random one of the same radius is tried, since limits and obstacles may bar that of
    the gradient.

    Args:
        problem: the task.
        q: (K, n) feasible configurations.
        energy: (K,) their energies.
        generator: of random numbers.
        steps: how many.
        accept: called with the rows that improve and where to (k, n); returns which of them may go there. All if
            not given.

    Returns:
        (K, n) configurations and (K,) energies, none higher than before.
    """
    q, energy = q.copy(), energy.copy()
    count, m, base = len(q), problem.free, problem.tracker.base
    if not count or not m:
        return q, energy
    H = np.tile(np.eye(m), (count, 1, 1))
    radius = np.full(count, RADIUS)
    gradient = reduced_gradient(problem, q)
    rows = np.arange(count)
    for _ in range(steps):
        step = -(H @ gradient[:, :, None])[:, :, 0]
        step *= np.minimum(1.0, radius / np.maximum(np.linalg.norm(step, axis=1), 1e-12))[:, None]
        blind = generator.normal(size=(count, 1, m))
        blind *= radius[:, None, None] / np.linalg.norm(blind, axis=2, keepdims=True)
        tries = np.concatenate([step[:, None] * LENGTHS[:, None], blind], axis=1)
        u = np.clip(q[:, None, base] + tries, problem.lower, problem.upper)
        reference = np.repeat(q, u.shape[1], axis=0)
        tried, energies = problem.follow(u.reshape(-1, m), reference)
        energies = energies.reshape(count, -1)
        best = energies.argmin(axis=1)
        better = energies[rows, best] < energy
        chosen = tried.reshape(count, -1, problem.robot.n)[rows, best]
        if accept is not None and better.any():
            better[better] = accept(np.flatnonzero(better), chosen[better])
        moved = np.where(better[:, None], chosen[:, base] - q[:, base], 0.0)
        q[better], energy[better] = chosen[better], energies[rows, best][better]
        last, gradient = gradient, reduced_gradient(problem, q)
        H = _updated(H, moved, gradient - last)
        radius = np.where(
            better, np.minimum(RADIUS, 1.5 * np.linalg.norm(moved, axis=1) + 0.3 * radius), 0.35 * radius
        )
        H[~better] = np.eye(m)
    return q, energy


def _updated(H: Array, s: Array, y: Array) -> Array:
    """BFGS update of inverse Hessians (K, m, m) where the curvature is positive."""
    curvature = (s * y).sum(axis=1)
    good = curvature > 1e-10
    rho = np.where(good, 1.0 / np.where(good, curvature, 1.0), 0.0)[:, None, None]
    left = np.eye(H.shape[1]) - rho * s[:, :, None] * y[:, None, :]
    updated: Array = left @ H @ left.transpose(0, 2, 1) + rho * s[:, :, None] * s[:, None, :]
    return updated
