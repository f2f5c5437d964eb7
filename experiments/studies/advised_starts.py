"""How often the advisor's advice can be driven: whole answers from random starts of one robot.

    python -m studies.advised_starts --robot gr --starts 100
    python -m studies.advised_starts --cell ./arms.yaml --robot panda --starts 100

A start is a configuration drawn evenly over the joints' ranges in which nothing is too near. The advisor is asked for
what is better with the hands where they are. With `--drive N` every option of the first N starts is driven to, in
virtual time and through the gate.
"""

import argparse
import time
from collections.abc import Sequence
from functools import partial
from itertools import combinations

import numpy as np
from pydantic import BaseModel

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import Option, advise
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.live import model_of
from deltaq_deploy.launch.program import run_program
from deltaq_protocol.arrays import Array
from studies.advised_drive import driven_to

CELLS = {"gr": "lab", "fr": "lab", "dawm": "dawm"}
"""The cell of each robot that is asked about without naming one."""
BETTER = 0.01
"""An option improves if its energy is less than that of the start by more than this fraction."""


class AdvisedStarts(BaseModel, frozen=True):
    """What the advisor made of some starts of a robot."""

    robot: str
    starts: int
    seed: int
    hands_may_leave: bool
    drivable: float
    """Share of the starts with an option that has a path."""
    improving: float
    """Share with an option that has a path and less energy than the start."""
    improving_in_place: float
    """The same with the hands in place all the way."""
    gain: float
    """Median fraction of the energy of the start that the best of these options saves."""
    options: float
    """Mean number of options with a path."""
    starts_by_options: dict[str, int]
    """Starts by how many options with a path they have."""
    least_apart: float | None
    """Least greatest difference of a joint between two options of a start [rad or m]."""
    without_path: float
    """Mean number of options without one."""
    p50_s: float
    p99_s: float
    longest_s: float
    """Wall time of an answer, all paths included."""
    cpu_p50_s: float
    cpu_p99_s: float
    tightest: dict[str, int]
    """Options by what is nearest of all that the hands' poses do not fix: self, environment, robots."""
    bound_by: dict[str, int]
    """Options by the clearance that costs most."""
    least_limit_share: float | None
    """Least distance of a joint of an option from its limit, as a fraction of its range."""
    least_limit_share_of_starts: float
    driven: int
    """Options that were driven to through the gate."""
    reached: int
    """How many of these the robot reached."""
    hands_off_m: float | None
    """Greatest distance of a hand from its place on the way there, of the options that keep the hands."""


def starts(cell: CellModel, robot: str, count: int, seed: int) -> list[Array]:
    """(n,) clear configurations, drawn evenly over the joints' ranges."""
    model, exact = cell.robots[robot], ExactClearance(cell, robot)
    generator, found = np.random.default_rng(seed), list[Array]()
    while len(found) < count:
        q = generator.uniform(model.lower, model.upper)
        if exact.keeps(q[None]):
            found.append(q)
    return found


def run(
    robot: str,
    count: int,
    seed: int,
    drive: int = 0,
    hands_may_leave: bool = False,
    cell_name: str | None = None,
) -> AdvisedStarts:
    """Ask from every start.

    Args:
        robot: the robot.
        count: number of starts.
        seed: of the starts.
        drive: to every option of so many of them.
        hands_may_leave: whether the hands may leave their place on the way to an option, and come back.
        cell_name: name or file of the cell; that of `CELLS` if not given.

    Raises:
        ControllerError: the cell has no such robot.
        AdvisorError: it has no joint to spare, and its hands may not leave.
    """
    cell_name = cell_name or CELLS[robot]
    cell = CellModel.load(cell_name)
    model = model_of(cell.robots, robot)
    tracker, exact = ConstraintTracker(model), ExactClearance(cell, robot)
    task = AdvisorProblem(cell, robot, tracker.hands(model.home), None, tracker, None, hands_may_leave)
    advise(task, model.home, generator=np.random.default_rng(0), effort=0.1, exact=exact)  # compiles
    wall_s, cpu_s, answers, here = [], [], list[list[Option]](), []
    placed = starts(cell, robot, count, seed)
    for number, q in enumerate(placed):
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        at = task.at(tracker.hands(q), hands_may_leave=hands_may_leave)
        answers.append(advise(at, q, generator=np.random.default_rng(number), exact=exact))
        wall_s.append(time.perf_counter() - began_s)
        cpu_s.append(time.process_time() - began_cpu_s)
        here.append(float(at.energies(q[None])[0]))
    better = [
        [one for one in answer if one.path is not None and one.energy < (1.0 - BETTER) * energy]
        for answer, energy in zip(answers, here, strict=True)
    ]
    gains = [
        1.0 - min(one.energy for one in found) / energy
        for found, energy in zip(better, here, strict=True)
        if found
    ]

    def ranked(q: Array, rank: int) -> Option | None:
        at = task.at(tracker.hands(q), hands_may_leave=hands_may_leave)
        found = advise(at, q, generator=np.random.default_rng(0), exact=exact)
        return next((one for one in found[rank:] if one.path is not None), None)

    drives = [
        one
        for q, answer in zip(placed[:drive], answers, strict=False)
        for rank in range(len(answer))
        if (one := driven_to(cell_name, robot, q, partial(ranked, rank=rank))) is not None
    ]
    offered = [one for answer in answers for one in answer if one.path is not None]
    shares = [np.minimum(q - model.lower, model.upper - q) / (model.upper - model.lower) for q in placed]
    return AdvisedStarts(
        robot=robot,
        starts=count,
        seed=seed,
        hands_may_leave=hands_may_leave,
        drivable=_share(any(one.path is not None for one in answer) for answer in answers),
        improving=_share(bool(found) for found in better),
        improving_in_place=_share(any(not one.hands_leave for one in found) for found in better),
        gain=float(np.median(gains)) if gains else 0.0,
        options=len(offered) / count,
        starts_by_options=_counts(sum(one.path is not None for one in answer) for answer in answers),
        least_apart=min(
            (
                float(np.abs(one.q - other.q).max())
                for answer in answers
                for one, other in combinations(answer, 2)
            ),
            default=None,
        ),
        without_path=sum(one.path is None for answer in answers for one in answer) / count,
        p50_s=float(np.median(wall_s)),
        p99_s=float(np.quantile(wall_s, 0.99)),
        longest_s=max(wall_s),
        cpu_p50_s=float(np.median(cpu_s)),
        cpu_p99_s=float(np.quantile(cpu_s, 0.99)),
        tightest=_counts(
            min(one.nearest, key=lambda kind: one.nearest[kind].room_m).name for one in offered if one.nearest
        ),
        bound_by=_counts(max(_CLEARANCES, key=lambda name: one.costs[name]) for one in offered),
        least_limit_share=min((one.limit_share for one in offered), default=None),
        least_limit_share_of_starts=float(np.min(shares)),
        driven=len(drives),
        reached=sum(drive.reached for drive in drives),
        hands_off_m=max(
            (drive.hands_off_m for drive in drives if drive.hands_off_m is not None), default=None
        ),
    )


_CLEARANCES = ("obstacle_clearance", "robot_clearance", "self_clearance")


def _share(flags: object) -> float:
    return float(np.mean(list(flags)))  # type: ignore[call-overload]


def _counts(names: object) -> dict[str, int]:
    listed = [str(name).lower() for name in names]  # type: ignore[attr-defined]
    return {name: listed.count(name) for name in sorted(set(listed))}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one table, or one JSON object."""
    parser = argparse.ArgumentParser(prog="python -m studies.advised_starts", description=__doc__)
    parser.add_argument("--cell", help=f"name or file; not needed for {', '.join(CELLS)}")
    parser.add_argument("--robot", default="dawm")
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--drive", type=int, default=0, help="drive to every option of so many starts")
    parser.add_argument("--hands-may-leave", action="store_true")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    if given.cell is None and given.robot not in CELLS:
        parser.error(f"--robot {given.robot}: name its cell as well, --cell NAME or FILE")
    found = run(given.robot, given.starts, given.seed, given.drive, given.hands_may_leave, given.cell)
    if given.json:
        print(found.model_dump_json(indent=2))
    else:
        for name, value in found.model_dump().items():
            print(f"{name}: {value}")


if __name__ == "__main__":
    run_program(main, "studies.advised_starts")
