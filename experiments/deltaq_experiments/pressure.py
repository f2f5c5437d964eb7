"""How hard an attack presses: in which share of the time the attacker could move as it wanted."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.leader.attacking import AttackingLeader
from deltaq_protocol.arrays import Array

HELD_BELOW = 0.1
"""An attacker whose tool goes slower than this part of what it asks for is held, by the gate or by its own limits."""


class Pressing:
    """An attacker that is looked at while it attacks.

    Args:
        leader: the attacker.
        model: of its robot.
        cycle_s: its cycle [s].
    """

    def __init__(self, leader: AttackingLeader, model: RobotModel, cycle_s: float) -> None:
        self._leader, self._cycle_s = leader, cycle_s
        self._tool = Kinematics(model, "tool")
        self._last: Array | None = None
        self._attacked = self._moved = 0

    def increment(self, view: View) -> Array:
        """The attacker's increment for this cycle, (n,) [rad or m]."""
        self._tool.update(view.own.q_cmd)
        tip, asked_m_s = self._tool.position, float(np.linalg.norm(self._leader.asked_m_s))
        if (
            self._last is not None
            and self._leader.attacking
            and asked_m_s > HELD_BELOW * self._leader.speed_m_s
        ):
            self._attacked += 1
            self._moved += bool(np.linalg.norm(tip - self._last) >= HELD_BELOW * asked_m_s * self._cycle_s)
        self._last = tip
        return self._leader.increment(view)

    @property
    def share(self) -> float | None:
        """Part of the attacking cycles in which it moved; None if it never attacked."""
        return self._moved / self._attacked if self._attacked else None
