"""The search: a global method, local polish, and distinct configurations of low energy, best first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.advisor.problem import AdvisorError, AdvisorProblem
from deltaq_controllers.criteria import Postures
from deltaq_protocol.arrays import Array, Flags, Indices

# Local minima of the energy by its gradient, many starts at once.
#
# The hands stay, so a free joint u takes the arm along: `J_arm dq_arm/du = -J_base`, and the energy's gradient over
# the free joints is `dE/du + dE/dq_arm dq_arm/du`. Steps are quasi-Newton ones (BFGS), several lengths of each tried
# at once.


LENGTHS = np.array([1.0, 0.4, 0.1, 0.02])
"""Fractions of a step that are tried."""

DAMPING = 1e-6
"""Added to the squares of an arm's Jacobian, so that a singular arm gives no infinite rates."""

RADIUS = 0.4
"""Longest step at first [rad or m]."""


def reduced_gradient(problem: AdvisorProblem, q: Array) -> Array:
    """(N, m) gradient of the energy by the free joints, at configurations (N, n)."""
    postures = Postures(problem.data, q)
    by_joint = np.zeros_like(q)
    by_joint[:, : problem.tracker.driven] = problem.energy.gradient(postures)
    base, jacobians = problem.tracker.base, problem.jacobians(q)
    gradient: Array = by_joint[:, base].copy()
    for hand, arm in enumerate(problem.tracker.arms):
        J = jacobians[:, hand]
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
    # a narrow range is a small unit, and what a limit bars is no way down
    scale = np.minimum(1.0, problem.upper - problem.lower)
    H = np.tile(np.diag(scale**2), (count, 1, 1))
    radius = np.full(count, RADIUS)
    gradient = reduced_gradient(problem, q)
    rows = np.arange(count)
    for _ in range(steps):
        barred = np.where(gradient > 0.0, q[:, base] <= problem.lower, q[:, base] >= problem.upper)
        step = -(H @ np.where(barred, 0.0, gradient)[:, :, None])[:, :, 0]
        step *= np.minimum(1.0, radius / np.maximum(np.linalg.norm(step, axis=1), 1e-12))[:, None]
        blind = generator.normal(size=(count, 1, m))
        blind *= scale * radius[:, None, None] / np.linalg.norm(blind, axis=2, keepdims=True)
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
        H[~better] = np.diag(scale**2)
    return q, energy


def _updated(H: Array, s: Array, y: Array) -> Array:
    """BFGS update of inverse Hessians (K, m, m) where the curvature is positive."""
    curvature = (s * y).sum(axis=1)
    good = curvature > 1e-10
    rho = np.where(good, 1.0 / np.where(good, curvature, 1.0), 0.0)[:, None, None]
    left = np.eye(H.shape[1]) - rho * s[:, :, None] * y[:, None, :]
    updated: Array = left @ H @ left.transpose(0, 2, 1) + rho * s[:, :, None] * s[:, None, :]
    return updated


# The global methods of Hooper and Noakes, Table 3, behind one interface.
#
# A method is a generator: it yields its findings and its progress often enough to be shown or stopped; a caller that
# stops asking has cancelled it. Effort 1 is what an operator waits for.


# Feasible configurations to start from.
#
# Few of all values of the free joints let every hand reach its pose: 0.1 to 4 % on a DAWM. Joints that move
# one hand only are therefore drawn for that hand alone, which multiplies the yields instead of the trials.


def feasible(
    problem: AdvisorProblem, generator: np.random.Generator, shared: int, own: int, at_most: int
) -> Array:
    """Values of the free joints with which every hand reaches its pose inside the limits; bodies are not checked.

    Args:
        problem: the task.
        generator: of random numbers.
        shared: how many values of the joints that move several hands are drawn.
        own: how many values of each hand's own joints are drawn for each of them.
        at_most: how many are returned.

    Returns:
        (N, m), N at most `at_most`, in random order.
    """
    tracker, base = problem.tracker, problem.tracker.base
    moves = tracker.kinematics.moves
    moved = np.array([moves[carrier, base] for carrier, _, _ in tracker.kinematics.hands])
    several = moved.sum(axis=0) != 1
    drawn = generator.uniform(problem.lower, problem.upper, (shared, own, problem.free))
    drawn[:, :, several] = drawn[:, :1, several]
    flat = drawn.reshape(-1, problem.free)
    problem.count += len(flat)
    reached = []
    for arm, branches in zip(tracker.arms, tracker.solve(flat, problem.poses), strict=True):
        lower, upper = problem.limits[:, arm.joints]
        _, inside = branches.fitted(0.5 * (lower + upper), lower, upper)
        reached.append(inside.any(axis=1).reshape(shared, own))
    starts = []
    for k in range(shared):
        choices = [np.flatnonzero(hand[k]) for hand in reached]
        if not all(len(choice) for choice in choices):
            continue
        count = max(len(choice) for choice in choices)
        start = np.empty((count, problem.free))
        start[:, several] = drawn[k, 0, several]
        for hand, choice in enumerate(choices):
            own_joints = moved[hand] & ~several
            start[:, own_joints] = drawn[k, np.resize(generator.permutation(choice), count)][:, own_joints]
        starts.append(start)
    if not starts:
        return np.empty((0, problem.free))
    together = np.concatenate(starts)
    picked: Array = together[generator.permutation(len(together))[:at_most]]
    return picked


@dataclass(frozen=True)
class Found:
    """Findings of a method since it was last asked.

    Attributes:
        q: (M, n) feasible configurations.
        energy: (M,) their energies.
        done: fraction of the work that is done, 0 to 1.
    """

    q: Array
    energy: Array
    done: float


Method = Callable[[AdvisorProblem, np.random.Generator, float], Iterator[Found]]

CHAINS, CHAIN_STEPS = 64, 30
BRANCHES_EVERY = 10
"""Steps of a chain after which it may change the branch of an arm; to try them all costs several trials."""
FIRST_TEMPERATURE, LAST_TEMPERATURE = 0.05, 5e-4
FIRST_STEP, LAST_STEP = 0.12, 0.01


def annealing(
    problem: AdvisorProblem, generator: np.random.Generator, effort: float = 1.0
) -> Iterator[Found]:
    """Simulated annealing in many short chains.

    III-C with the acceptance `exp(-(E_trial - E) / kT)` that the print leaves out, see the errata. One long chain that
    cools slowly ends in one option; short ones end in several.
    """
    q, energy = _start(problem, generator, CHAINS)
    yield Found(q, energy, 0.1)
    steps = max(1, round(CHAIN_STEPS * effort))
    extent, base = problem.upper - problem.lower, problem.tracker.base
    for step in range(steps if len(q) else 0):
        share = step / steps
        temperature = FIRST_TEMPERATURE * (LAST_TEMPERATURE / FIRST_TEMPERATURE) ** share
        size = FIRST_STEP * (LAST_STEP / FIRST_STEP) ** share
        change = generator.normal(size=(len(q), problem.free)) * size * extent
        change *= generator.random(change.shape) < 0.6  # only some joints in each trial
        if step % BRANCHES_EVERY == 0:
            trial, trial_energy = problem.try_best(q[:, base] + change)
        else:
            trial, trial_energy = problem.follow(q[:, base] + change, q)
        accepted = generator.random(len(q)) < np.exp(-np.maximum(trial_energy - energy, 0.0) / temperature)
        accepted &= np.isfinite(trial_energy)
        q, energy = np.where(accepted[:, None], trial, q), np.where(accepted, trial_energy, energy)
        yield Found(q, energy, 0.1 + 0.9 * (step + 1) / steps)


def shotgun(problem: AdvisorProblem, generator: np.random.Generator, effort: float = 1.0) -> Iterator[Found]:
    """Gradient tracking from many starts."""
    rounds = max(1, round(2 * effort))
    for number in range(rounds):
        q, energy = _start(problem, generator, 24)
        for part in range(4):
            q, energy = descend(problem, q, energy, generator, 6)
            yield Found(q, energy, (number + 0.25 * (part + 1)) / rounds)


def genetic(problem: AdvisorProblem, generator: np.random.Generator, effort: float = 1.0) -> Iterator[Found]:
    """A genetic algorithm: tournaments, blended parents, mutation, and the best of old and new survive."""
    q, energy = _start(problem, generator, CHAINS)
    yield Found(q, energy, 0.1)
    generations = max(1, round(CHAIN_STEPS * effort))
    extent, base = problem.upper - problem.lower, problem.tracker.base
    for generation in range(generations if len(q) else 0):
        size = FIRST_STEP * (LAST_STEP / FIRST_STEP) ** (generation / generations)
        contest = generator.integers(len(q), size=(2, 2, len(q)))
        winners = np.where(energy[contest[:, 0]] < energy[contest[:, 1]], contest[:, 0], contest[:, 1])
        blend = generator.uniform(-0.25, 1.25, (len(q), problem.free))
        children = blend * q[winners[0]][:, base] + (1.0 - blend) * q[winners[1]][:, base]
        mutated = generator.random(children.shape) < 0.3
        children += mutated * generator.normal(size=children.shape) * size * extent
        trial, trial_energy = problem.try_best(children)
        q, energy = np.concatenate([q, trial]), np.concatenate([energy, trial_energy])
        kept = np.argsort(energy, kind="stable")[: min(CHAINS, int(np.isfinite(energy).sum()))]
        q, energy = q[kept], energy[kept]
        yield Found(q, energy, 0.1 + 0.9 * (generation + 1) / generations)


def monte_carlo(
    problem: AdvisorProblem, generator: np.random.Generator, effort: float = 1.0
) -> Iterator[Found]:
    """Trials drawn evenly over the free joints' ranges."""
    rounds = max(1, round(20 * effort))
    for number in range(rounds):
        trials = problem.try_all(generator.uniform(problem.lower, problem.upper, (1000, problem.free)))
        yield Found(trials.q, trials.energy, (number + 1) / rounds)


def brute_force(
    problem: AdvisorProblem, _generator: np.random.Generator, effort: float = 1.0
) -> Iterator[Found]:
    """Every point of a coarse grid."""
    side = max(2, int((20_000 * effort) ** (1.0 / problem.free)))
    axes = [
        np.linspace(low, high, side + 2)[1:-1] for low, high in zip(problem.lower, problem.upper, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, problem.free)
    for start in range(0, len(points), 1000):
        trials = problem.try_all(points[start : start + 1000])
        yield Found(trials.q, trials.energy, min(1.0, (start + 1000) / len(points)))


METHODS: dict[str, Method] = {
    "annealing": annealing,
    "shotgun": shotgun,
    "genetic": genetic,
    "monte-carlo": monte_carlo,
    "brute-force": brute_force,
}
"""All methods by name."""


def _start(problem: AdvisorProblem, generator: np.random.Generator, count: int) -> tuple[Array, Array]:
    """At most `count` feasible configurations, drawn until there are enough or few can be hoped for."""
    q, energy = np.empty((0, problem.robot.n)), np.empty(0)
    for attempt in range(6):
        drawn = feasible(problem, generator, 96 * (attempt + 1), 32, 4 * count)
        tried, energies = problem.try_best(drawn)
        good = np.isfinite(energies)
        q, energy = np.concatenate([q, tried[good]]), np.concatenate([energy, energies[good]])
        if len(q) >= count:
            break
    kept = generator.permutation(len(q))[:count]
    return q[kept], energy[kept]


DISTINCT = 0.5
"""The posture distance: options differ by more than this in at least one joint [rad or m]."""

POLISHED = ((32, 5), (8, 12))
"""How many configurations are polished, and by how many steps: many a little, then the best of them."""

POOL = 400
"""Configurations that are kept while searching."""


@dataclass
class Pool:
    """The best configurations found so far.

    Attributes:
        q: (M, n) configurations, best first.
        energy: (M,) their energies.
    """

    q: Array
    energy: Array = field(default_factory=lambda: np.empty(0))

    def add(self, q: Array, energy: Array) -> None:
        """Add configurations; the worst are forgotten."""
        good = np.isfinite(energy)
        q, energy = np.concatenate([self.q, q[good]]), np.concatenate([self.energy, energy[good]])
        order = np.argsort(energy, kind="stable")[: 4 * POOL]
        self.q, self.energy = q[order], energy[order]

    @property
    def best(self) -> float:
        """Least energy in the pool; infinite if it is empty."""
        return float(self.energy[0]) if len(self.energy) else float("inf")

    def distinct(self, count: int) -> NDArray[np.intp]:
        """Indices of the best that differ from all better ones by more than `DISTINCT` in some joint."""
        left = np.ones(len(self.q), dtype=np.bool_)
        chosen: list[int] = []
        while left.any() and len(chosen) < count:
            best = int(np.argmax(left))
            chosen.append(best)
            left &= np.abs(self.q - self.q[best]).max(axis=1) > DISTINCT
        return np.array(chosen, dtype=np.intp)


def search(
    problem: AdvisorProblem,
    generator: np.random.Generator,
    method: str = "annealing",
    effort: float = 1.0,
    go_on: Callable[[str, float, float], bool] = lambda *_: True,
) -> Pool:
    """Find configurations of low energy, polished; without a free joint all there are.

    Args:
        problem: the task.
        generator: of random numbers.
        method: one of `METHODS`.
        effort: of the method; 1 is what an operator waits for.
        go_on: called with the present activity, its completed fraction and the least energy so far; once it returns
            False, the findings so far are polished and returned.

    Returns:
        Distinct configurations, best first; empty if nothing was found.

    Raises:
        AdvisorError: no such method.
    """
    check_method(method)
    pool = Pool(np.empty((0, problem.robot.n)))
    if not problem.free:
        every = problem.try_all(np.empty((1, 0)))
        pool.add(every.q, every.energy)
    for found in METHODS[method](problem, generator, effort) if problem.free else ():
        pool.add(found.q, found.energy)
        if not go_on("searching", found.done, pool.best):
            break
    go_on("polishing", 0.0, pool.best)
    for count, steps in POLISHED:
        rough = pool.distinct(count)
        pool.add(*descend(problem, pool.q[rough], pool.energy[rough], generator, steps))
    kept = pool.distinct(POOL)
    return Pool(pool.q[kept], pool.energy[kept])


def check_method(name: str) -> None:
    """Raise an `AdvisorError` for an unknown method."""
    if name not in METHODS:
        raise AdvisorError(f"no method {name!r}; there are {', '.join(METHODS)}")
