"""The advisor's methods side by side (Hooper and Noakes, Table 3): energy against processor time on seeded tasks.

    python -m studies.advised_methods --tasks 10

A task is the hand poses of a clear configuration of the dual-arm robot, drawn at random. Best known is the least energy
that any search of the run has found for it.
"""

import argparse
import time
from collections.abc import Sequence

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.advisor.search import METHODS, search
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_deploy.launch.program import run_program
from studies.advised_starts import CELLS, starts

GOOD = 0.01
"""A search is good if it ends within this fraction of the best known energy."""
EFFORTS = (0.3, 1.0, 3.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one table, a row for each method and effort."""
    parser = argparse.ArgumentParser(prog="python -m studies.advised_methods", description=__doc__)
    parser.add_argument("--robot", choices=("dawm", "gr"), default="dawm")
    parser.add_argument("--tasks", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    cell = CellModel.load(CELLS[given.robot])
    robot = cell.robots[given.robot]
    tracker = ConstraintTracker(robot)
    task = AdvisorProblem(cell, given.robot, tracker.hands(robot.home), None, tracker)
    search(task, np.random.default_rng(0), effort=0.1)  # compiles
    searches = [(method, effort) for method in METHODS for effort in EFFORTS]
    energy, cpu_s = np.empty((2, len(searches), given.tasks))
    for number, q in enumerate(starts(cell, given.robot, given.tasks, given.seed)):
        at = task.at(tracker.hands(q))
        for row, (method, effort) in enumerate(searches):
            began_s = time.process_time()
            energy[row, number] = search(at, np.random.default_rng(number), method, effort).best
            cpu_s[row, number] = time.process_time() - began_s
    above = energy / energy.min(axis=0) - 1.0
    print(
        "| method | effort | processor time [s], median / longest | above the best known, median / worst | good |"
    )
    print("| --- | --- | --- | --- | --- |")
    for (method, effort), gap, took_s in zip(searches, above, cpu_s, strict=True):
        print(
            f"| {method} | {effort:g} | {np.median(took_s):.2f} / {took_s.max():.2f} | {100 * np.median(gap):.2f} % / "
            f"{100 * gap.max():.1f} % | {(gap <= GOOD).sum()} of {given.tasks} |"
        )


if __name__ == "__main__":
    run_program(main, "studies.advised_methods")
