"""How far a hand goes along each axis, how straight, and what a step costs: `python -m studies.directions`.

From home each axis is driven for a time in either sense, all hands at once and, of several hands, the first one by
itself. The robot does what is asked for; the gate is left out, so that the modes are compared and nothing else. With
`--keeps-clear` it keeps clear of itself and its surroundings as when it is driven, the other robots at home.
"""

import argparse
import gc
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.live import model_of
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.practice import practise
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_deploy.launch.program import run_program
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import HAND_AXES, TELEOPERATION, DrivingMode, OperatorCommand

HAND_M_S, HAND_RAD_S = 0.1, 0.2
"""Rates that are commanded."""

WHOLE = 0.95
"""Part of the commanded way that counts as all of it: the rest is what speeding up takes."""


@dataclass(frozen=True)
class DirectionGone:
    """One axis, driven for a time.

    Attributes:
        axis: with its sense, as `+x` or `-left.rz`.
        reached: the least way along it of the hands that were driven [m or rad].
        share: of the way that the rate alone would give.
        off_line_mm: greatest distance of any hand from its line.
        off_line_deg: greatest angle of any hand from what its line asks for.
        limited: what limited the drive at its end, in words; empty if nothing did.
    """

    axis: str
    reached: float
    share: float
    off_line_mm: float
    off_line_deg: float
    limited: str


@dataclass(frozen=True)
class Steps:
    """Processor time of the steps of all directions, of each step the least of all passes [ms]."""

    p50_ms: float
    p99_ms: float
    max_ms: float


def commands(robot: RobotModel) -> Iterator[dict[str, float]]:
    """Each axis in either sense: of all hands, and of several hands of the first alone."""
    named = (*HAND_AXES, *(f"{robot.hands[0]}.{axis}" for axis in HAND_AXES if len(robot.hands) > 1))
    for axis in named:
        rate = HAND_RAD_S if axis.rpartition(".")[2].startswith("r") else HAND_M_S
        for sense in (1.0, -1.0):
            yield {axis: sense * rate}


def drive(
    robot: RobotModel,
    mode: DrivingMode,
    rates: dict[str, float],
    duration_s: float,
    cycle_s: float,
    clear_in: CellModel | None = None,
) -> tuple[list[Array], list[float], str]:
    """Drive from home: setpoints (n,), processor time of each step [s], and what limited the last one.

    Args:
        robot: the robot.
        mode: its mode.
        rates: of one axis [m/s or rad/s].
        duration_s: of the drive [s].
        cycle_s: of the robot [s].
        clear_in: its cell, to keep clear of what is there; the other robots stand at home.
    """
    around = None if clear_in is None else RobotSurroundings(clear_in, robot.name)
    homes = {name: other.home for name, other in ({} if clear_in is None else clear_in.robots).items()}
    homes.pop(robot.name, None)
    teleoperator = Teleoperator(robot, cycle_s, mode, surroundings=around)
    practise(teleoperator)  # to compile is no part of a step
    q = robot.home.copy()
    way, seconds = [q], []
    teleoperator.command = OperatorCommand(rates)
    for cycle in range(1, round(duration_s / cycle_s) + 1):
        time_s = cycle * cycle_s
        others = {name: RobotView(cycle, time_s, home, home) for name, home in homes.items()}
        view = View(RobotView(cycle, time_s, q, q), others)
        begin = time.thread_time()
        dq = teleoperator.increment(view)
        seconds.append(time.thread_time() - begin)
        q = q + dq
        way.append(q)
    limitation = teleoperator.limitation
    return way, seconds, limitation.text if limitation is not None else ""


def judged(
    robot: RobotModel, rates: dict[str, float], way: Sequence[Array], duration_s: float, limited: str = ""
) -> DirectionGone:
    """How far along its line, and how far off, a way of configurations (n,) takes the hands."""
    ((axis, rate),) = rates.items()
    hand, _, plain = axis.rpartition(".")
    driven = [robot.hands.index(hand)] if hand else list(range(len(robot.hands)))
    column, hands = HAND_AXES.index(plain), Hands(robot)
    hands.update(way[0])
    start = hands.rotations.copy(), hands.positions.copy()
    off, reached = np.zeros(2), 0.0
    for q in way:
        hands.update(q)
        moved = -hands.error(*start).reshape(-1, 6)
        reached = float((np.sign(rate) * moved[driven, column]).min())
        moved[driven, column] = 0.0
        off = np.maximum(off, np.linalg.norm(moved.reshape(-1, 2, 3), axis=2).max(axis=0))
    return DirectionGone(
        axis=("+" if rate > 0.0 else "-") + axis,
        reached=reached,
        share=reached / (abs(rate) * duration_s),
        off_line_mm=1000.0 * float(off[0]),
        off_line_deg=float(np.rad2deg(off[1])),
        limited=limited,
    )


def run(
    cell: str,
    robot: str,
    mode: DrivingMode,
    duration_s: float = 6.0,
    passes: int = 1,
    keeps_clear: bool = False,
    progress: Callable[[DirectionGone], None] = lambda _: None,
) -> tuple[list[DirectionGone], Steps]:
    """Drive every direction.

    Args:
        cell: name or file of the cell.
        robot: a robot of it.
        mode: a mode that drives hands.
        duration_s: of each drive [s].
        passes: how often each is driven; other programs that share the core slow down a step of one pass.
        keeps_clear: whether the robot keeps clear of itself and its surroundings.
        progress: called with each direction that is done.

    Raises:
        ControllerError: there is no such robot, or it cannot be driven in that mode.
    """
    loaded = CellModel.load(cell)
    model, cycle_s = model_of(loaded.robots, robot), loaded.description.cycle_s
    clear_in = loaded if keeps_clear else None
    directions: list[DirectionGone] = []
    seconds: list[float] = []
    gc.collect()
    gc.freeze()
    for rates in commands(model):
        drives = [drive(model, mode, rates, duration_s, cycle_s, clear_in) for _ in range(passes)]
        way, _, limited = drives[0]
        directions.append(judged(model, rates, way, duration_s, limited))
        seconds += np.min([taken for _, taken, _ in drives], axis=0).tolist()
        progress(directions[-1])
    gc.unfreeze()
    p50, p99, most = (round(1000.0 * float(np.percentile(seconds, p)), 4) for p in (50, 99, 100))
    return directions, Steps(p50, p99, most)


def main() -> int:
    """Print the directions of one robot in each mode."""
    parser = argparse.ArgumentParser(prog="python -m studies.directions", description=__doc__)
    parser.add_argument("--cell", default="dawm", help="name or file (default: %(default)s)")
    parser.add_argument("--robot", default="dawm", help="robot of it (default: %(default)s)")
    parser.add_argument(
        "--mode",
        nargs="+",
        choices=[mode.value for mode in TELEOPERATION],
        default=["decoupled", "coupled"],
        help="default: both of hands",
    )
    parser.add_argument("--duration-s", type=float, default=6.0, help="of each (default: %(default)s)")
    parser.add_argument("--passes", type=int, default=1, help="drives of each axis (default: %(default)s)")
    parser.add_argument(
        "--keeps-clear", action="store_true", help="of itself and its surroundings, as when it is driven"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a mode")
    options = parser.parse_args()
    if options.passes < 1:
        parser.error(f"--passes {options.passes}: at least 1")
    for name in options.mode:
        directions, steps = run(
            options.cell,
            options.robot,
            DrivingMode(name),
            options.duration_s,
            options.passes,
            options.keeps_clear,
        )
        whole = sum(one.share >= WHOLE for one in directions)
        if options.json:
            told = {
                "robot": options.robot,
                "mode": name,
                "keeps_clear": options.keeps_clear,
                "whole": whole,
                "directions": [asdict(one) for one in directions],
                "steps": asdict(steps),
            }
            print(json.dumps(told), flush=True)
            continue
        print(f"{options.robot}, {name}: {whole} of {len(directions)} directions in whole")
        for one in directions:
            print(
                f"  {one.axis:>9} {one.reached:7.3f} {100 * one.share:4.0f} %"
                f"  off {one.off_line_mm:8.5f} mm {one.off_line_deg:8.5f} deg  {one.limited}"
            )
        print(f"  a step takes {steps.p50_ms:.3f} ms, p99 {steps.p99_ms:.3f} ms", flush=True)
    return 0


if __name__ == "__main__":
    run_program(main, "studies.directions")
