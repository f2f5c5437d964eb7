"""How well two hands keep an object between them.

Each seed drives from home through random directions and speeds, from one to the next without a rest, until limits,
singularities and speeds bind. In half of the drives a random part of the cycles is lost: there the robot does what the
gate has it do then, and brakes straight in joint space, so that the hands leave their lines.
"""

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.modes.hands import Hands, HeldObject
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.driving import HAND_AXES, DrivingMode, Grip, OperatorCommand

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
    mode: DrivingMode,
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
