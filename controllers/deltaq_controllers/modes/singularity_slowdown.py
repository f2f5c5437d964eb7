"""Stop before a hand would leave its line, at singularities and at the edge of the workspace.

Damping keeps joint rates finite there by omitting part of the motion, which takes the hand off its line. So
the whole motion is slowed with the omitted fraction, down to rest, unless it leads out.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.motion import Motion
from deltaq_controllers.modes.resolved_rate import WEAK, Inverse
from deltaq_protocol.arrays import Array

STANDING_LOSS = 0.3
"""Fraction of a motion that the damping leaves out when the robot has come to a stand."""

_UNHEEDED_LOSS = 0.01
_AHEAD_S = 1e-3


def slowed(hands: Hands, inverse_at: Callable[[Array], Inverse], q: Array, motion: Motion) -> Motion:
    """The motion, slowed as far as its direction is lost.

    Args:
        hands: of the robot.
        inverse_at: places the hands at a configuration (n,) and inverts their Jacobian.
        q: (n,) configuration [rad or m].
        motion: that is commanded.
    """
    wanted = motion.hands.ravel()
    inverse = inverse_at(q)
    if inverse.weakest >= WEAK or not wanted.any():
        return motion
    rates = inverse(wanted)
    asked, made = inverse.left @ wanted, inverse.left @ (hands.jacobian @ rates)
    loss = float(np.linalg.norm(asked - made) / np.linalg.norm(asked))
    if loss < _UNHEEDED_LOSS or inverse_at(q + _AHEAD_S * rates).weakest > inverse.weakest:
        return motion
    return motion.scaled(max(0.0, 1.0 - loss / STANDING_LOSS))
