"""A leader that tries to hit the follower: an operator with bad intentions, or with bad sight.

It homes in on a point of the follower, however that moves, withdraws, and comes again from elsewhere. Its requests
need not be admitted by the gate.
"""

from itertools import cycle

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError, View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.leader.scripted import (
    STICK_ACCELERATION_M_S2,
    ScriptedLeader,
    Workspace,
    acceleration_of_stick,
)
from deltaq_protocol.arrays import Array

TARGETS = ("lens", "wrist", "elbow", "all")
"""What an attack can be aimed at; `all` takes them in turn."""

ATTACK_S, WITHDRAW_S = 5.0, 3.0


class HomingStick:
    """Tool velocities towards a moving point.

    Args:
        speed_m_s: speed that the operator keeps [m/s].
        cycle_s: time between two calls [s].
        acceleration_m_s2: largest acceleration that is asked for [m/s^2].

    Attributes:
        point: (3,) where to [m].
        velocity: (3,) the last velocity [m/s].
    """

    def __init__(
        self, speed_m_s: float, cycle_s: float, acceleration_m_s2: float = STICK_ACCELERATION_M_S2
    ) -> None:
        self._speed, self._cycle_s = speed_m_s, cycle_s
        self._acceleration = acceleration_of_stick(acceleration_m_s2)
        self.point: Array | None = None
        self.velocity: Array = np.zeros(3)

    def update(self, position: Array) -> Array:
        """The next velocity (3,) for a tool at `position` (3,) [m/s]."""
        wanted = np.zeros(3)
        if self.point is not None:
            way = self.point - position
            far = float(np.linalg.norm(way))
            # the speed from which the tool can still stop at the point
            wanted = (min(self._speed, np.sqrt(2.0 * self._acceleration * far)) / max(far, 1e-9)) * way
        change = wanted - self.velocity
        size, largest = float(np.linalg.norm(change)), self._acceleration * self._cycle_s
        self.velocity = wanted if size <= largest else self.velocity + (largest / size) * change
        return self.velocity

    def give_up(self) -> None:
        """An attacker does not give up, it pushes again."""
        self.velocity = np.zeros(3)


def staging_box(model: RobotModel) -> Workspace:
    """The box that a robot's tool withdraws to, to attack from there."""
    return Workspace.around(Kinematics(model, "tool").position, (0.25, 0.25, 0.15))


class AttackingLeader:
    """Moves a robot's tool at another robot, withdraws, and repeats.

    Args:
        model: the robot; any number of joints from six on.
        victim: the robot to hit.
        cycle_s: cycle of both [s].
        speed_m_s: speed of the tool [m/s].
        seed: of the points that the attacks come from.
        target: one of `TARGETS`; `lens` needs a victim with a camera.
        stick_m_s2: largest acceleration of the tool that is asked for [m/s^2].

    Attributes:
        attacking: whether it attacks; else it withdraws.
        speed_m_s: as given.
    """

    def __init__(
        self,
        model: RobotModel,
        victim: RobotModel,
        cycle_s: float,
        speed_m_s: float = 0.25,
        seed: int = 0,
        target: str = "lens",
        stick_m_s2: float = STICK_ACCELERATION_M_S2,
    ) -> None:
        if target not in TARGETS:
            raise ControllerError(f"target must be one of {', '.join(TARGETS)}, got {target!r}")
        self._victim, self._cycle_s, self.speed_m_s = victim, cycle_s, speed_m_s
        self._stick = HomingStick(speed_m_s, cycle_s, stick_m_s2)
        self._leader = ScriptedLeader(model, cycle_s, speed_m_s, seed, stick=self._stick)
        self._random = np.random.default_rng(seed)
        self._targets = cycle(TARGETS[:3] if target == "all" else (target,))
        self._target = next(self._targets)
        self._staging = staging_box(model)
        self._from = Kinematics(model, "tool").position
        self._left_s = ATTACK_S
        self.attacking = True

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        self._left_s -= self._cycle_s
        if self._left_s <= 0.0:
            self._turn()
        victim = view.others.get(self._victim.name)
        if self.attacking and victim is not None:
            self._stick.point = self._aim(victim.q)
        else:
            self._stick.point = self._from
        return self._leader.increment(view)

    @property
    def asked_m_s(self) -> Array:
        """(3,) velocity that the tool was last asked for [m/s]."""
        return self._stick.velocity

    def _turn(self) -> None:
        self.attacking = not self.attacking
        self._left_s = ATTACK_S if self.attacking else WITHDRAW_S
        if self.attacking:
            self._target = next(self._targets)
        else:
            self._from = self._random.uniform(self._staging.low, self._staging.high)

    def _aim(self, q: Array) -> Array:
        """(3,) the point of the victim that is aimed at [m]."""
        if self._target == "lens":
            lens: Array = self._victim.camera_pose(q)[:3, 3]
            return lens
        # of a six-axis arm the fifth joint is the wrist and the third the elbow
        joint: Array = self._victim.joint_origins(q)[-2 if self._target == "wrist" else -4]
        return joint
