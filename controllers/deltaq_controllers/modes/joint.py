"""Joint mode: each joint by itself. It needs no inverse, so it works in every configuration."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.interface import TeleoperationMode
from deltaq_controllers.modes.limitation import Limitation
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_protocol.arrays import Array


class JointMode(TeleoperationMode):
    """Drives joints independently (Hooper & Noakes, section II)."""

    name = ModeName.JOINT
    drives_hands = False

    def __init__(self, robot: RobotModel) -> None:
        self.drives_joints = np.ones(robot.n, dtype=np.bool_)

    def step(self, _q: Array, motion: Motion, time_s: float) -> Array:
        """The displacement asked for."""
        displacement: Array = motion.joints * time_s
        return displacement

    def limitation(self, _q: Array, _motion: Motion) -> Limitation | None:
        """None: only the joints' own limits bound this mode."""
        return None
