"""The advisor's methods side by side: time and quality on seeded tasks of the dual-arm cell.

A task is the hand poses of a random clear configuration. Best known is the least energy that any method, or a
longer search of two of them, has found for it in the same run. A second part times whole answers, all options with the
paths to them, from the home of each robot that the advisor knows.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import advise
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.methods import METHODS
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.advisor.search import Pool, search
from deltaq_controllers.advisor.space import HandsKept
from deltaq_controllers.inverse.titan import TitanInverse
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array

TASKS = 12
LONGER = {"annealing": 4.0, "shotgun": 3.0}
"""Methods, and their efforts, that search for the best known energy."""
ANSWERED = (("dawm", "dawm"), ("lab", "gr"))
"""Cells and robots of which whole answers are timed."""
GOOD = 0.01
"""A search is good if it ends within this fraction of the best known energy."""


class AdvisorBenchRow(BaseModel):
    """One method over all tasks."""

    model_config = ConfigDict(frozen=True)

    method: str
    median_s: float
    """Wall time of a search, polish included."""
    worst_s: float
    median_cpu_s: float
    """Processor time of the same."""
    median_gap: float | None
    """Fraction by which the energy found is above the best known; None where nothing was found."""
    worst_gap: float | None
    good: int
    """Tasks solved within 1 % of the best known."""
    least_options: int
    """Distinct options that are clear by the exact shapes, on the task with the fewest."""
    trials: int
    """Mean over the tasks."""


class TimedAnswer(BaseModel):
    """Whole answers of the advisor for one robot, from its home, search after search."""

    model_config = ConfigDict(frozen=True)

    cell: str
    robot: str
    median_cpu_s: float
    """Processor time from the question to the last path."""
    worst_cpu_s: float
    options: float
    """Mean number of options in an answer."""
    barred: float
    """Mean number of these that lie beyond a singularity."""
    ways: float
    """Mean number of these to which a path was found."""


class AdvisorBenchTable(BaseModel):
    """All methods of one run."""

    model_config = ConfigDict(frozen=True)

    tasks: int
    inverse_poses_per_s: float
    """Poses of a Titan II solved per second of processor time, all branches, many at once."""
    inverse_one_by_one_per_s: float
    """The same in a plain loop, one pose a call."""
    best_known: tuple[float, ...]
    rows: tuple[AdvisorBenchRow, ...]
    answers: tuple[TimedAnswer, ...]


def tasks(cell: CellModel, robot: str, count: int = TASKS) -> list[Array]:
    """Seeded tasks: (h, 4, 4) poses of the hands at random clear configurations."""
    model, exact = cell.robots[robot], ExactClearance(cell, robot)
    tracker, generator = ConstraintTracker(model), np.random.default_rng(0)
    found: list[Array] = []
    while len(found) < count:
        q = generator.uniform(model.lower, model.upper)
        if exact.measure(q).room_m > 0.02:
            found.append(tracker.hands(q))
    return found


def run(
    cell_name: str | Path = "dawm",
    robot: str = "dawm",
    count: int = TASKS,
    on_step: Callable[[int, int], None] | None = None,
) -> AdvisorBenchTable:
    """Measure every method on every task.

    Args:
        cell_name: the cell.
        robot: the robot.
        count: how many tasks.
        on_step: called with the number of tasks done and the number of all.
    """
    cell = CellModel.load(cell_name)
    tracker, exact = ConstraintTracker(cell.robots[robot]), ExactClearance(cell, robot)
    wall, cpu = np.zeros((len(METHODS), count)), np.zeros((len(METHODS), count))
    energy, options = np.full((len(METHODS), count), np.inf), np.zeros((len(METHODS), count), dtype=int)
    trials, best = np.zeros((len(METHODS), count)), np.full(count, np.inf)
    for number, poses in enumerate(tasks(cell, robot, count)):
        task = AdvisorProblem(cell, robot, poses, None, tracker)
        for longer, effort in LONGER.items():
            best[number] = min(
                best[number], search(task, np.random.default_rng(100 + number), longer, effort).best
            )
        for row, method in enumerate(METHODS):
            task.count = 0
            began_s, began_cpu_s = time.perf_counter(), time.process_time()
            pool = search(task, np.random.default_rng(number), method)
            wall[row, number] = time.perf_counter() - began_s
            cpu[row, number] = time.process_time() - began_cpu_s
            energy[row, number], trials[row, number] = pool.best, task.count
            options[row, number] = clear_options(pool, exact)
        best[number] = min(best[number], energy[:, number].min())
        if on_step is not None:
            on_step(number + 1, count)
    gap = energy / best - 1.0
    rows = tuple(
        AdvisorBenchRow(
            method=method,
            median_s=float(np.median(wall[row])),
            worst_s=float(wall[row].max()),
            median_cpu_s=float(np.median(cpu[row])),
            median_gap=_finite(np.median(gap[row])),
            worst_gap=_finite(gap[row].max()),
            good=int((gap[row] <= GOOD).sum()),
            least_options=int(options[row].min()),
            trials=round(float(trials[row].mean())),
        )
        for row, method in enumerate(METHODS)
    )
    many, single = inverse_rates()
    return AdvisorBenchTable(
        tasks=count,
        inverse_poses_per_s=many,
        inverse_one_by_one_per_s=single,
        best_known=tuple(best.tolist()),
        rows=rows,
        answers=tuple(whole_answers(*named, count) for named in ANSWERED),
    )


def whole_answers(cell_name: str, robot: str, count: int) -> TimedAnswer:
    """Ask the advisor `count` times, each with another seed, for options and the paths to them."""
    cell = CellModel.load(cell_name)
    tracker, exact, home = (
        ConstraintTracker(cell.robots[robot]),
        ExactClearance(cell, robot),
        cell.robots[robot].home,
    )
    space = HandsKept(tracker, tracker.hands(home))
    cpu, options = np.zeros(count), []
    for seed in range(count):
        task = AdvisorProblem(cell, robot, tracker.hands(home), None, tracker)
        began_s = time.process_time()
        options += advise(task, home, generator=np.random.default_rng(seed), exact=exact)
        cpu[seed] = time.process_time() - began_s
    return TimedAnswer(
        cell=cell_name,
        robot=robot,
        median_cpu_s=float(np.median(cpu)),
        worst_cpu_s=float(cpu.max()),
        options=len(options) / count,
        barred=sum(bool(space.barred(home, option.q)) for option in options) / count,
        ways=sum(option.path is not None for option in options) / count,
    )


def inverse_rates(count: int = 100_000, loop: int = 2000) -> tuple[float, float]:
    """Poses that the closed form of the Titan II solves per second of processor time, best of three.

    Args:
        count: poses that are solved together.
        loop: poses that are solved one by one, in a plain loop.

    Returns:
        Many at once, and one by one.
    """
    arm = TitanInverse()
    poses = arm.forward(np.random.default_rng(0).uniform(-np.pi, np.pi, (count, 6)))
    many, single = [], []
    for _ in range(3):
        began_s = time.process_time()
        arm.inverse(poses)
        many.append(count / (time.process_time() - began_s))
        began_s = time.process_time()
        for pose in poses[:loop]:
            arm.inverse(pose)
        single.append(loop / (time.process_time() - began_s))
    return max(many), max(single)


def clear_options(pool: Pool, exact: ExactClearance, at_most: int = 5) -> int:
    """How many distinct options of a search are clear by the exact shapes, counted to `at_most`."""
    count = 0
    for q in pool.q:
        count += exact.measure(q).room_m > 0.0
        if count == at_most:
            break
    return count


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
