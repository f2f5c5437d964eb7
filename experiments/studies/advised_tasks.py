"""What the free axes of the shipped tasks are worth, to the advisor and to the mode `coupled`.

    python -m studies.advised_tasks --starts 20 --seed 0

Each task is asked about from random starts, as it is and with every axis kept. Energies of both are those of the task
as it is. From the same starts `coupled` moves every hand of the task by 0.1 m/s for 1.5 s in a random direction.
"""

import argparse
import time
from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import advise
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import WEIGHTS, AdvisorProblem, NotRedundantError
from deltaq_controllers.criteria import RobotData
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.modes.hand_modes import CoupledMode, weighed
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_controllers.task import AXES, Task, Tolerance, load_task, shipped
from deltaq_deploy.launch.program import run_program
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode, OperatorCommand
from studies.advised_starts import CELLS, starts

SPEED_M_S, DRIVEN_S = 0.1, 1.5


def kept(task: Task) -> Task:
    """The task with every axis kept."""
    hands = {name: hand.model_copy(update={"tolerance": Tolerance()}) for name, hand in task.hands.items()}
    return task.model_copy(update={"hands": hands})


def in_region(cell: CellModel, task: Task, count: int, seed: int) -> list[Array]:
    """(n,) clear configurations with the hands in their regions."""
    robot, found, drawn = cell.robots[task.robot], list[Array](), 0
    while len(found) < count:
        for q in starts(cell, task.robot, count, seed + 1000 * drawn):
            regions = [(task.region(hand), robot.forward(q, hand)[:3, 3]) for hand in task.hands]
            if all(region is None or region.holds(place) for region, place in regions):
                found.append(q)
        drawn += 1
    return found[:count]


class Asked:
    """Answers for one task.

    Args:
        cell: as the task sees it.
        task: the task.
    """

    def __init__(self, cell: CellModel, task: Task) -> None:
        robot = cell.robots[task.robot]
        self._tracker, self._exact = ConstraintTracker(robot, task), ExactClearance(cell, task.robot)
        home = self._tracker.hands(robot.home)
        self.problem = AdvisorProblem(cell, task.robot, home, tracker=self._tracker, hands_may_leave=True)
        _ = self.problem.references  # computed once

    def best(self, q: Array) -> tuple[Array, int, float]:
        """Best configuration, number of options with a path, and processor time [s]."""
        began_s = time.process_time()
        try:
            at = self.problem.at(self._tracker.hands(q))
            found = advise(at, q, generator=np.random.default_rng(0), exact=self._exact)
        except NotRedundantError:
            return q, 1, time.process_time() - began_s
        ways = [one for one in found if one.path is not None]
        return (ways[0].q if ways else q), len(ways), time.process_time() - began_s


class Driven:
    """Drives in `coupled` for one task.

    Args:
        cell: as the task sees it.
        task: the task.
    """

    def __init__(self, cell: CellModel, task: Task) -> None:
        # its region would end the drive
        hands = {name: hand.model_copy(update={"region": None}) for name, hand in task.hands.items()}
        self._cell, self._task = cell, (task := task.model_copy(update={"hands": hands}))
        criteria = (weighed(RobotData(cell, task.robot, task=task), task.weights or WEIGHTS),)
        self._mode = CoupledMode(cell.robots[task.robot], criteria, task)
        self._around = RobotSurroundings(cell, task.robot)

    def end(self, q: Array, direction: Array) -> Array:
        """Where a drive ends."""
        robot, cycle_s = self._cell.robots[self._task.robot], self._cell.description.cycle_s
        modes = {DrivingMode.COUPLED: lambda _: self._mode}
        by_hand = Teleoperator(robot, cycle_s, DrivingMode.COUPLED, modes=modes, surroundings=self._around)
        several = len(robot.hands) > 1
        rates = {
            (f"{hand}.{axis}" if several else axis): SPEED_M_S * part
            for hand in self._task.hands
            for axis, part in zip("xyz", direction.tolist(), strict=True)
        }
        for cycle in range(round((DRIVEN_S + 0.5) / cycle_s)):
            moves = cycle * cycle_s < DRIVEN_S
            by_hand.command = OperatorCommand(rates) if moves else OperatorCommand()
            q = q + by_hand.increment(View(RobotView(cycle, cycle * cycle_s, q, q)))
        return q


def off(
    cell: CellModel, task: Task, before: Array, after: Array, direction: Array
) -> tuple[float, float, float]:
    """How far a drive along a direction (3,) of the world has hands off their lines.

    Returns:
        Distance [m] and turn [deg] where the task tolerates nothing, and the greatest part of a tolerance that is used.
    """
    tracker = ConstraintTracker(cell.robots[task.robot], task)
    places, now = tracker.hands(before), tracker.hands(after)
    # along its line a hand may be anywhere, so the slides are judged across it
    off_m, off_deg = 0.0, 0.0
    for number, hand in enumerate(tracker.robot.hands):
        moved = now[number, :3, 3] - places[number, :3, 3]
        axes = task.hands[hand].tolerance.axes() if hand in task.hands else []
        free = [now[number, :3, AXES.index(axis)] for axis in axes if axis in AXES[:3]]
        span = np.stack([direction if hand in task.hands else np.zeros(3), *free], axis=1)
        off_m = max(off_m, float(np.linalg.norm(moved - span @ np.linalg.lstsq(span, moved, rcond=None)[0])))
        places[number, :3, 3] = now[number, :3, 3]
    q = tracker.with_tolerances(after, places)
    for T, place in zip(tracker.hands(q), places, strict=True):
        off_deg = max(off_deg, float(np.rad2deg(np.linalg.norm(pin.log3(T[:3, :3].T @ place[:3, :3])))))
    extra = slice(tracker.driven, None)
    used = np.abs(q[extra] / tracker.robot.upper[extra])
    return off_m, off_deg, float(used.max(initial=0.0))


def shown(values: Iterable[float], form: str = ".3f") -> str:
    """Median, least and greatest."""
    listed = np.array(list(values))
    return " ".join(format(x, form) for x in (np.median(listed), listed.min(), listed.max()))


def study(name: str, count: int, seed: int) -> None:
    """Print what one task gains."""
    task = load_task(name)
    cell = task.seen(CellModel.load(CELLS[task.robot]))
    places = in_region(cell, task, count, seed)
    free, fixed = Asked(cell, task), Asked(cell, kept(task))
    generator = np.random.default_rng(seed)
    free.best(places[0]), fixed.best(places[0])  # compiles
    rows = [(q, free.best(q), fixed.best(q)) for q in places]

    def energy(q: Array) -> float:
        return float(free.problem.energies(q[None])[0])

    gains = [1.0 - energy(one[0]) / energy(other[0]) for _, one, other in rows]
    print(
        f"{name}: {free.problem.free} free joints, {fixed.problem.free} with every axis kept, {count} starts"
    )
    for label, answers in (("free", [row[1] for row in rows]), ("kept", [row[2] for row in rows])):
        three = np.mean([answer[1] >= 3 for answer in answers])
        print(
            f"  {label}: options {np.mean([answer[1] for answer in answers]):.2f}, "
            f"three or more in {100 * three:.0f} %, processor time s {shown(answer[2] for answer in answers)}"
        )
    better = np.mean([gain > 0.001 for gain in gains])
    print(
        f"  best option's energy lower by % {shown((100 * gain for gain in gains), '.2f')}, in {100 * better:.0f} %"
    )
    one, other = Driven(cell, task), Driven(cell, kept(task))
    drives = []
    for q in places:
        direction = generator.normal(size=3)
        direction /= np.linalg.norm(direction)
        ends = one.end(q, direction), other.end(q, direction)
        drives.append((energy(ends[1]) - energy(ends[0]), energy(q), off(cell, task, q, ends[0], direction)))
    gains = [100 * drive[0] / drive[1] for drive in drives]
    better = np.mean(np.array(gains) > 0.0)
    print(f"  coupled: energy at the end lower by % {shown(gains, '.2f')}, in {100 * better:.0f} %")
    print(
        f"  coupled: off kept axes mm {1000 * max(drive[2][0] for drive in drives):.4f}, "
        f"deg {max(drive[2][1] for drive in drives):.4f}, "
        f"greatest part of a tolerance used {max(drive[2][2] for drive in drives):.3f}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what the tasks gain."""
    parser = argparse.ArgumentParser(prog="python -m studies.advised_tasks", description=__doc__)
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("tasks", nargs="*", default=shipped())
    given = parser.parse_args(arguments)
    for name in given.tasks:
        study(name, given.starts, given.seed)


if __name__ == "__main__":
    run_program(main, "studies.advised_tasks")
