"""How well two hands keep an object between them: `python -m deltaq_experiments.held_object`.

Each seed drives from home through random directions and speeds, from one to the next without a rest, until limits,
singularities and speeds bind. In half of the drives a random part of the cycles is lost: there the robot does what the
gate has it do then, and brakes straight in joint space, so that the hands leave their lines.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.live import model_of
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_controllers.modes.motion import HAND_AXES, Grip, ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_launch.program import run_program
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles

DIRECTIONS, DIRECTION_S = 6, 1.5
MOST_M_S, MOST_RAD_S = 0.4, 0.8
LOST_SHARE, MOST_LOST = 0.02, 25
"""How often cycles begin to be lost, and how many of them at most."""


def wishes(random: np.random.Generator) -> dict[str, float]:
    """Two axes of the object, at random rates up to the greatest."""
    axes = random.choice(HAND_AXES, 2, replace=False)
    return {
        str(axis): float(random.uniform(-1.0, 1.0)) * (MOST_RAD_S if axis.startswith("r") else MOST_M_S)
        for axis in axes
    }


def drive(
    robot: RobotModel,
    mode: ModeName,
    grip: Grip,
    cycle_s: float,
    seed: int,
    lost_share: float = 0.0,
    directions: int = DIRECTIONS,
) -> Array:
    """Drive through random directions: how far the hands are off from one another in each cycle, (c, 2) [m, rad].

    Args:
        robot: with several hands.
        mode: that drives them.
        grip: `free`, in which all hands get the same command, shows what `object` is for.
        cycle_s: the robot's cycle [s].
        seed: of the directions and of what is lost.
        lost_share: how often cycles begin to be lost.
        directions: how many, one after the other.
    """
    random, teleoperator, hands = (
        np.random.default_rng(seed),
        Teleoperator(robot, cycle_s, mode),
        Hands(robot),
    )
    taken = HeldObject(hands.rotations, hands.positions)
    q, dq, lost = robot.home.copy(), np.zeros(robot.n), 0
    parted = []
    for cycle in range(round(directions * DIRECTION_S / cycle_s)):
        if not cycle % round(DIRECTION_S / cycle_s):
            rates = wishes(random)
        if not lost and random.random() < lost_share:
            lost = int(random.integers(1, MOST_LOST + 1))
        teleoperator.command = OperatorCommand(rates, grip=grip)
        asked = teleoperator.increment(View(RobotView(cycle, cycle * cycle_s, q, q)))
        if lost:
            lost -= 1
            asked = dq * (1.0 - 1.0 / brake_cycles(dq, teleoperator.limits.max_ddq))
        q, dq = q + asked, asked
        hands.place(q)
        parted.append(taken.parted(hands.rotations, hands.positions))
    return np.array(parted)


def distribution(parted: Sequence[Array]) -> dict[str, float]:
    """Median, 99 % and worst over all cycles of all drives, and the median of the drives' worst [mm, deg]."""
    every, worst = np.vstack(parted), np.array([one.max(axis=0) for one in parted])
    found = {}
    for column, (unit, factor) in enumerate((("mm", 1000.0), ("deg", float(np.rad2deg(1.0))))):
        figures = factor * every[:, column]
        for name, percentile in (("p50", 50), ("p99", 99), ("max", 100)):
            found[f"{name}_{unit}"] = float(np.percentile(figures, percentile))
        found[f"median_of_worst_{unit}"] = float(np.median(factor * worst[:, column]))
    return found


def main() -> int:
    """Print the distribution of each mode, grip and share of lost cycles."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_experiments.held_object", description=__doc__)
    parser.add_argument("--cell", default="dawm", help="name or file (default: %(default)s)")
    parser.add_argument(
        "--robot", default="dawm", help="robot of it with several hands (default: %(default)s)"
    )
    parser.add_argument("--seeds", type=int, default=20, help="drives of each kind (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args()
    loaded = CellModel.load(options.cell)
    robot, cycle_s = model_of(loaded.robots, options.robot), loaded.description.cycle_s
    if options.seeds < 1:
        parser.error(f"--seeds {options.seeds}: at least 1")
    if len(robot.hands) < 2:
        parser.error(f"--robot {options.robot}: it has one hand, and an object is held by two or more")
    for mode in (ModeName.DECOUPLED, ModeName.COUPLED):
        for grip, lost_share in ((Grip.OBJECT, 0.0), (Grip.OBJECT, LOST_SHARE), (Grip.FREE, 0.0)):
            seeds = range(options.first_seed, options.first_seed + options.seeds)
            found = distribution([drive(robot, mode, grip, cycle_s, seed, lost_share) for seed in seeds])
            told = {"mode": mode.value, "grip": grip.value, "lost_share": lost_share} | found
            if options.json:
                print(json.dumps(told), flush=True)
                continue
            print(
                f"{mode.value}, {grip.value}, {100 * lost_share:g} % lost: median {found['p50_mm']:.4f} mm, "
                f"99 % {found['p99_mm']:.4f} mm, worst {found['max_mm']:.4f} mm {found['max_deg']:.4f} deg",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.held_object")
