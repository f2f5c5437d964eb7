"""Feasible configurations to start from.

Few of all values of the free joints let every hand reach its pose: 0.1 to 4 % on a DAWM. Joints that move one hand
only are therefore drawn for that hand alone, which multiplies the yields instead of the trials.
"""

from __future__ import annotations

import numpy as np

from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_protocol.arrays import Array


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
