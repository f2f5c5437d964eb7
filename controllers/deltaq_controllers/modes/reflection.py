"""How much of what an operator asks for goes through, for the operator to see and to feel. Pure."""

from __future__ import annotations

import math

from deltaq_cell.compiled import compiled
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.motion import Motion
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome, Verdict

SMOOTHED_S = 0.1
"""Time constant with which the share follows: a single cycle is not felt [s]."""


def share_of(asked: Motion, rates: Array, hands: Hands) -> float:
    """The share of a motion's rates that joints at rates (n,) make along it, 0 to 1; 1 for no motion.

    Args:
        asked: the motion.
        rates: (n,) of the joints [rad/s or m/s].
        hands: of the robot, placed where it is.
    """
    if asked.along:
        return float(rates.any())
    return _share(asked.joints, asked.hands, rates, hands.units, hands.jacobian)


@compiled
def _share(joints: Array, twists: Array, rates: Array, units: Array, jacobian: Array) -> float:
    """`share_of` for rates of joints (n,) and twists of hands (h, 6)."""
    square, along = 0.0, 0.0
    for joint in range(len(joints)):
        square += joints[joint] ** 2
        along += joints[joint] * rates[joint]
    for row in range(len(units)):
        wanted = units[row] * twists[row // 6, row % 6]
        if wanted != 0.0:
            made = 0.0
            for joint in range(len(rates)):
                made += jacobian[row, joint] * rates[joint]
            square += wanted**2
            along += wanted * units[row] * made
    return min(1.0, max(0.0, along / square)) if square > 0.0 else 1.0


class Reflection:
    """The share that goes through the mode and the gate, while something limits the operator.

    Args:
        cycle_s: the robot's cycle [s].

    Attributes:
        share: from 0, nothing, to 1, all of it or nothing that limits.
    """

    def __init__(self, cycle_s: float) -> None:
        self._follows = 1.0 - math.exp(-cycle_s / SMOOTHED_S)
        self._admitted = 1.0
        self.share = 1.0

    def take(self, share: float, is_asked: bool, is_limited: bool) -> None:
        """A cycle in which a fraction of the requested motion, if there is any, was requested of the gate.

        Acceleration is not a limit: the fraction counts while a limit binds, in the mode or at the gate.
        """
        is_reflected = is_asked and (is_limited or self._admitted < 1.0)
        now = share * self._admitted if is_reflected else 1.0
        self.share += self._follows * (now - self.share)

    def take_verdict(self, verdict: Verdict) -> None:
        """Take the gate's verdict on it."""
        is_whole = verdict.outcome is Outcome.ADMITTED
        self._admitted = 1.0 if is_whole else max(0.0, min(1.0, verdict.scale))
