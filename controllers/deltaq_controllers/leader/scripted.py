"""A scripted leader: an operator with a joystick, without the operator.

The operator steers the tool from one random point of a box to the next, as fast as allowed nearly all the time;
the stick's dynamics bound the tool's acceleration. Gantry and arm share the motion by a damped weighted
pseudoinverse that also holds the tool's orientation, and drift back to where they started.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError, LastIncrement, View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.limits import IncrementLimits
from deltaq_protocol.arrays import Array

STICK_ACCELERATION_M_S2 = 2.0
"""Largest acceleration of the tool that the operator asks for, unless told otherwise [m/s^2]."""


@dataclass(frozen=True)
class Workspace:
    """The box in the world that the leader's tool moves in.

    Attributes:
        low: lowest corner [m].
        high: highest corner [m].
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @classmethod
    def around(cls, centre: Array, half_size: tuple[float, float, float]) -> Workspace:
        """A box around a point (3,), by half its edges [m]."""
        low, high = centre - np.array(half_size), centre + np.array(half_size)
        return cls((low[0], low[1], low[2]), (high[0], high[1], high[2]))


class Stick(Protocol):
    """Steers a tool.

    Attributes:
        velocity: (3,) the last velocity [m/s].
    """

    velocity: Array

    def update(self, position: Array) -> Array:
        """The next velocity (3,) for a tool at `position` (3,) [m/s]."""
        ...

    def give_up(self) -> None:
        """The robot does not move as commanded."""
        ...


def acceleration_of_stick(stick_m_s2: float) -> float:
    """An acceleration that can be asked for, as given [m/s^2].

    Raises:
        ControllerError: it cannot be.
    """
    if not 0.0 < stick_m_s2 < np.inf:
        raise ControllerError(f"stick_m_s2 must be a finite number of m/s^2 above 0, got {stick_m_s2}")
    return stick_m_s2


class Joystick:
    """Tool velocities as an operator's stick gives them.

    Args:
        speed_m_s: speed that the operator keeps [m/s].
        seed: seed of the points steered to.
        workspace: box that the points lie in.
        cycle_s: time between two calls [s].
        acceleration_m_s2: largest acceleration that is asked for [m/s^2].

    Attributes:
        velocity: (3,) the last velocity [m/s].
    """

    def __init__(
        self,
        speed_m_s: float,
        seed: int,
        workspace: Workspace,
        cycle_s: float,
        acceleration_m_s2: float = STICK_ACCELERATION_M_S2,
    ) -> None:
        self._low, self._high = np.array(workspace.low), np.array(workspace.high)
        if not 0.0 <= speed_m_s < np.inf:
            raise ControllerError(f"speed_m_s must be a finite number of m/s, 0 or more, got {speed_m_s}")
        if not (self._low < self._high).all():
            raise ControllerError(
                f"workspace: each of low {workspace.low} must be below high {workspace.high} [m]"
            )
        self._speed, self._cycle_s = speed_m_s, cycle_s
        self._acceleration = acceleration_of_stick(acceleration_m_s2)
        self._random = np.random.default_rng(seed)
        self._point: Array | None = None
        self.velocity: Array = np.zeros(3)

    def update(self, position: Array) -> Array:
        """The next velocity (3,) for a tool at `position` (3,) [m/s]."""
        turn_m = self._speed**2 / (2.0 * self._acceleration) + 0.02
        if self._point is None or np.linalg.norm(self._point - position) < turn_m:
            self._point = self._next_point(position)
        way = self._point - position
        wanted = self._speed * way / max(float(np.linalg.norm(way)), 1e-9)
        change = wanted - self.velocity
        largest = self._acceleration * self._cycle_s
        size = float(np.linalg.norm(change))
        self.velocity = wanted if size <= largest else self.velocity + (largest / size) * change
        return self.velocity

    def give_up(self) -> None:
        """Release the stick, and steer to another point next."""
        self._point = None
        self.velocity = np.zeros(3)

    def _next_point(self, position: Array) -> Array:
        """A random point of the box, at least half its longest edge away."""
        points = self._random.uniform(self._low, self._high, (16, 3))
        away = np.linalg.norm(points - position, axis=1)
        far = points[away > 0.5 * float((self._high - self._low).max())]
        return np.array(far[0] if len(far) else points[int(np.argmax(away))])


class ScriptedLeader:
    """Moves a robot's tool about a box at a steady speed.

    Args:
        model: the robot; any number of joints from six on.
        cycle_s: cycle of the robot [s].
        speed_m_s: largest tool speed, kept nearly always [m/s].
        seed: seed of the motion; one seed is one motion.
        stick: moves the tool in place of the joystick that the box, the seed and the acceleration are for.
        stick_m_s2: largest acceleration of the tool that the joystick asks for [m/s^2].
    """

    posture_rate = 0.3
    """Rate at which redundant joints return to where they started [1/s]."""
    orientation_rate = 2.0
    """Rate at which the tool's orientation returns to its start [1/s]."""
    revolute_weight = 2.0
    """Cost of a rad/s at an arm's joint, in m/s of a prismatic one."""
    patience_s = 0.5
    """Time for which the tool may be blocked before another point is chosen [s]."""
    damping = 0.02
    """Added to the diagonal of `J W^-1 J^T` (linear rows in m^2, angular rows in rad^2)."""

    def __init__(
        self,
        model: RobotModel,
        cycle_s: float,
        speed_m_s: float = 0.25,
        seed: int = 0,
        stick: Stick | None = None,
        stick_m_s2: float = STICK_ACCELERATION_M_S2,
    ) -> None:
        if model.n < 6:
            raise ControllerError(f"the leader needs six joints or more, robot {model.name!r} has {model.n}")
        self.limits = IncrementLimits.of(model, cycle_s)
        self._kinematics = Kinematics(model, "tool")
        home = Kinematics(model, "tool").position
        self.workspace = Workspace.around(home, (0.35, 0.3, 0.15))
        self._joystick: Stick = stick or Joystick(speed_m_s, seed, self.workspace, cycle_s, stick_m_s2)
        self._cycle_s = cycle_s
        self._inverse_weights = np.where(model.revolute, 1.0 / self.revolute_weight**2, 1.0)
        self._last = LastIncrement(self.limits.max_ddq)
        self._stuck_s = 0.0
        self._start: tuple[Array, Array] | None = None

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        q_cmd, dq_last = view.own.q_cmd, self._last.update(view.own)
        kinematics = self._kinematics
        kinematics.update(q_cmd)
        if self._start is None:
            self._start = (q_cmd.copy(), kinematics.rotation.copy())
        q_start, rotation_start = self._start
        turn = rotation_start @ kinematics.rotation.T
        # the axial vector of the rotation back, its length the sine of the angle
        back = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        jacobian = kinematics.jacobian()
        self._watch_progress(float(np.linalg.norm(jacobian[:3] @ dq_last)) / self._cycle_s)
        twist = np.concatenate([self._joystick.update(kinematics.position), self.orientation_rate * back])
        weighted = jacobian * self._inverse_weights
        drift = self.posture_rate * (q_start - q_cmd)
        square = weighted @ jacobian.T + self.damping**2 * np.eye(6)
        rates = drift + weighted.T @ np.linalg.solve(square, twist - jacobian @ drift)
        dq = self._cycle_s * rates
        too_fast = float(np.max(np.abs(dq) / self.limits.max_dq))
        return self.limits.admissible(dq / max(too_fast, 1.0), q_cmd, dq_last)

    def _watch_progress(self, speed_m_s: float) -> None:
        """An operator whose robot is held by the gate turns elsewhere."""
        asked = float(np.linalg.norm(self._joystick.velocity))
        self._stuck_s = self._stuck_s + self._cycle_s if speed_m_s < 0.1 * asked else 0.0
        if self._stuck_s > self.patience_s:
            self._joystick.give_up()
            self._stuck_s = 0.0
