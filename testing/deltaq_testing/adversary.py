"""Malicious controllers: each tries to break an invariant of the gate by its own tactic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array

Tactic = Callable[[Array, Array], Array]
"""(n,) own setpoint and (3,) the other robot's tool [m] to (n,) increment."""


class Adversary:
    """Changes its tactic at random times, from a seed.

    Args:
        robot: what it drives.
        cycle_s: sample time of the robot.
        random: source of all its choices.
    """

    def __init__(self, robot: RobotModel, cycle_s: float, random: np.random.Generator) -> None:
        self._robot = robot
        self._random = random
        self._fastest = robot.max_velocity * cycle_s
        self._left = 0
        self._tactic: Tactic = self._noise
        self._aim = np.zeros(robot.n)
        self._count = 0
        self.tactic_name = ""

    def increment(self, q_cmd: Array, target_m: Array) -> Array:
        """The next attack, (n,) [rad or m]."""
        if self._left == 0:
            tactics: tuple[Tactic, ...] = (
                self._noise, self._homing, self._limit_rider, self._brake_and_bolt, self._alternating,
                self._runaway, self._return,
            )  # fmt: skip
            self._tactic = tactics[int(self._random.integers(len(tactics)))]
            self.tactic_name = self._tactic.__name__.lstrip("_")
            self._left = int(self._random.integers(10, 150))
            self._aim = self._random.uniform(-1.0, 1.0, self._robot.n)
        self._left -= 1
        self._count += 1
        return self._tactic(q_cmd, target_m)

    def _noise(self, q_cmd: Array, _target_m: Array) -> Array:
        return self._random.uniform(-1.5, 1.5, q_cmd.size) * self._fastest

    def _homing(self, q_cmd: Array, target_m: Array) -> Array:
        """The tool flies at the other robot's tool as fast as it goes."""
        J = self._robot.jacobian(q_cmd)[:3]
        towards = target_m - self._robot.forward(q_cmd)[:3, 3]
        dq = J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(3), towards)
        return self._at_full_speed(dq)

    def _limit_rider(self, q_cmd: Array, _target_m: Array) -> Array:
        """Each joint moves to one of its limits."""
        limit = np.where(self._aim > 0, self._robot.upper, self._robot.lower)
        return np.clip(limit - q_cmd, -self._fastest, self._fastest)

    def _brake_and_bolt(self, q_cmd: Array, _target_m: Array) -> Array:
        """Nothing for a while, then everything at once."""
        return self._at_full_speed(self._aim) if self._count % 20 < 12 else np.zeros_like(q_cmd)

    def _alternating(self, _q_cmd: Array, _target_m: Array) -> Array:
        return (1.0 if self._count % 2 else -1.0) * self._at_full_speed(self._aim)

    def _runaway(self, _q_cmd: Array, _target_m: Array) -> Array:
        return 3.0 * self._at_full_speed(self._aim)

    def _return(self, q_cmd: Array, _target_m: Array) -> Array:
        """Back home, to start from somewhere else; a cornered robot attacks nobody."""
        return 0.1 * (self._robot.home - q_cmd)

    def _at_full_speed(self, dq: Array) -> Array:
        return dq / max(float(np.max(np.abs(dq) / self._fastest)), 1e-12)
