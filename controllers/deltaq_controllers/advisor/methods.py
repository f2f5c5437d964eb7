"""The global methods of Hooper and Noakes, Table 3, behind one interface.

A method is a generator: it yields its findings and its progress often enough to be shown or stopped; a caller that
stops asking has cancelled it. Effort 1 is what an operator waits for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from deltaq_controllers.advisor.descent import descend
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_protocol.arrays import Array

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
        lower, upper = problem.robot.lower[arm.joints], problem.robot.upper[arm.joints]
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

CHAINS, CHAIN_STEPS = 64, 50
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
