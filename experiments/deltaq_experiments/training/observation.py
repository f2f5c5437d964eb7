"""What a policy sees of a robot: what any controller sees, and the last increment that its setpoints tell."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from deltaq_controllers.interface import LastIncrement, RobotView
from deltaq_controllers.limits import IncrementLimits
from deltaq_protocol.arrays import Array

RobotObservation = dict[str, Array]
"""`q`, `q_cmd` and `dq` of a robot, (n,) each [rad or m]."""

BEYOND_CYCLES = 3.0
"""How far beyond a limit a robot may come while it lags behind its setpoints, in cycles at full speed."""
ROUNDED_UP = 1.01
"""Telegrams round setpoints, so that the largest increment may seem a little larger."""


class RobotObserver:
    """Follows one robot.

    Args:
        limits: of its increments.
    """

    def __init__(self, limits: IncrementLimits) -> None:
        self._last = LastIncrement(limits.max_ddq)

    def observe(self, view: RobotView) -> RobotObservation:
        """What is seen of it now."""
        return {"q": view.q, "q_cmd": view.q_cmd, "dq": self._last.update(view)}


def robot_space(limits: IncrementLimits) -> spaces.Dict[Array]:
    """What observations of a robot are in."""
    beyond, largest = BEYOND_CYCLES * limits.max_dq, ROUNDED_UP * limits.max_dq
    position = spaces.Box(limits.lower - beyond, limits.upper + beyond, dtype=np.float64)
    increment = spaces.Box(-largest, largest, dtype=np.float64)
    return spaces.Dict({"q": position, "q_cmd": position, "dq": increment})
