"""Joint mode: each joint by itself. It needs no inverse, so it works in every configuration."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.stepped import SteppedMode
from deltaq_protocol.arrays import Array


class JointMode(SteppedMode):
    """Drives joints independently (Hooper & Noakes, section II); only their own limits bound it."""

    name = ModeName.JOINT
    drives_hands = False

    def __init__(self, robot: RobotModel) -> None:
        super().__init__(robot)
        self.drives_joints = np.ones(robot.n, dtype=np.bool_)

    def step(self, _q: Array, motion: Motion, time_s: float) -> Array:
        """The displacement asked for."""
        displacement: Array = motion.joints * time_s
        return displacement
