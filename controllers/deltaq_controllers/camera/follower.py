"""The camera follower of Bjerkeng et al., III: look at the leader's tool from a desired distance, evading."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.law import CameraLaw, FollowerGains
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.redundancy import Emergency
from deltaq_controllers.spheres import PlacedSpheres
from deltaq_protocol.arrays import Array

# The integration of the law over its virtual horizon, III-F.

VectorField = Callable[[Array], Array]

_STILL = 1e-300
"""A joint that moves by less never reaches its cap [rad or m]."""


def runge_kutta_step(field: VectorField, q: Array, rates: Array, step_s: float) -> Array:
    """Displacement over one classical Runge-Kutta step.

    Args:
        field: velocity of each configuration.
        q: (n,) start.
        rates: (n,) `field(q)`, already computed by the caller.
        step_s: length of the step [s].
    """
    k2 = field(q + (0.5 * step_s) * rates)
    k3 = field(q + (0.5 * step_s) * k2)
    k4 = field(q + step_s * k3)
    return _weighted_mean(rates, k2, k3, k4, step_s)


@compiled
def _weighted_mean(k1: Array, k2: Array, k3: Array, k4: Array, step_s: float) -> Array:
    """Displacement by the four stages of a step."""
    return (step_s / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)


@compiled
def largest_share(rates: Array, cap: Array) -> float:
    """The largest rate of a joint by its cap [1/s]."""
    return float((np.abs(rates) / cap).max())


@compiled
def share_inside(start: Array, step: Array, cap: Array) -> float:
    """Largest s in [0, 1] with `|start + s step| <= cap` for every joint; `start` lies inside."""
    room = cap - np.sign(step) * start
    return min(1.0, float((room / np.maximum(np.abs(step), _STILL)).min()))


def integrate(
    field: VectorField,
    q: Array,
    horizon_s: float,
    max_step_s: float,
    cap: Array,
    max_share: float = 0.2,
    max_steps: int = 40,
) -> Array:
    """Displacement along the field over the horizon, or to where the first joint reaches its cap.

    Args:
        field: velocity of each configuration [rad/s or m/s].
        q: (n,) start, the commanded reference [rad or m].
        horizon_s: virtual time to integrate over [s].
        max_step_s: longest step [s].
        cap: (n,) largest increment [rad or m].
        max_share: fraction of the cap that one step may cover.
        max_steps: number of steps after which the integration ends.

    Returns:
        (n,) increment [rad or m].
    """
    moved = np.zeros_like(q)
    left_s = horizon_s
    for _ in range(max_steps):
        rates = field(q + moved)
        fastest = largest_share(rates, cap)
        step_s = min(left_s, max_step_s)
        if step_s * fastest > max_share:
            step_s = max_share / fastest
        step = runge_kutta_step(field, q + moved, rates, step_s)
        share = share_inside(moved, step, cap)
        moved = moved + share * step
        left_s -= step_s
        if share < 1.0 or left_s <= 1e-9 * horizon_s:
            break
    return moved


# The velocity of the focus, which the view has to compensate.


class FocusTracker:
    """An alpha-beta filter of a point.

    Args:
        alpha: fraction of the innovation that goes into the position.
        beta: fraction of the innovation that goes into the velocity.
        gap_s: after a longer silence than this the estimate restarts [s].

    Attributes:
        velocity: (3,) estimate [m/s].
    """

    def __init__(self, alpha: float = 0.7, beta: float = 0.4, gap_s: float = 0.5) -> None:
        self._alpha, self._beta, self._gap_s = alpha, beta, gap_s
        self._position: Array | None = None
        self._time_s = 0.0
        self.velocity: Array = np.zeros(3)

    def update(self, position: Array, time_s: float) -> None:
        """Add a measurement.

        Args:
            position: (3,) measured point [m].
            time_s: when it was measured, on any one clock; a stamp seen before changes nothing [s].
        """
        elapsed = time_s - self._time_s
        if self._position is None or elapsed < 0.0 or elapsed > self._gap_s:
            self._position, self.velocity = position.copy(), np.zeros_like(position)
        elif elapsed > 0.0:
            expected = self._position + elapsed * self.velocity
            innovation = position - expected
            self._position = expected + self._alpha * innovation
            self.velocity = self.velocity + (self._beta / elapsed) * innovation
        self._time_s = time_s


class CameraFollower:
    """Increments that make a robot's camera look at a focus from a desired distance.

    The paper's controller: view direction first, then, in its null space, clearance from the leader and
    the floor, view distance and camera roll.

    Args:
        robot: the robot that carries the camera.
        leader: the robot to keep clear of, None for none.
        cycle_s: cycle of the robot [s].
        gains: gains of the law.
        floor_m: height of the floor to keep clear of, None for none [m].

    Attributes:
        robot, cycle_s, gains: as given.
        limits: limits of the increments.
        clearance_m: least clearance of bounding spheres at the last increment [m].

    Raises:
        RobotModelError: the robot carries no camera.
    """

    def __init__(
        self,
        robot: RobotModel,
        leader: RobotModel | None,
        cycle_s: float,
        gains: FollowerGains | None = None,
        floor_m: float | None = 0.0,
    ) -> None:
        gains = gains or FollowerGains()
        self.robot, self.cycle_s, self.gains = robot, cycle_s, gains
        self.limits = IncrementLimits.of(robot, cycle_s)
        self.clearance_m = np.inf
        self._law = CameraLaw(robot, cycle_s, self.limits.max_dq, gains, floor_m)
        self._leader = PlacedSpheres(leader) if leader is not None else None
        self._emergency = Emergency(gains.emergency_on_m, gains.emergency_off_m)
        self._tracker = FocusTracker()
        self._warm_up(leader)

    def _warm_up(self, leader: RobotModel | None) -> None:
        """Compile further functions now, because the first cycle leaves no time for it."""
        gains, q = self.gains, np.array(self.robot.home)
        integrate(self._law.rates, q, gains.horizon_s, gains.max_step_s, self.limits.max_dq)
        self._obstacles(leader.home if leader is not None else None)

    def increment(
        self,
        q_cmd: Array,
        dq_last: Array,
        p_focus: Array,
        q_leader: Array | None,
        desired_distance: float,
        time_s: float,
    ) -> Array:
        """One increment, III-F.

        Args:
            q_cmd: (n,) commanded reference: the last setpoint, with all increments in flight [rad or m].
            dq_last: (n,) increment that led to it [rad or m].
            p_focus: (3,) focus in the world, as it was measured or where it will be [m].
            q_leader: (m,) configuration of the leader, None if it is not known.
            desired_distance: desired view distance d_r [m].
            time_s: stamp of the leader's state, on any one clock [s].

        Returns:
            (n,) increment within the robot's limits of position, speed and acceleration [rad or m].
        """
        self._tracker.update(p_focus, time_s)
        # one kind of array: for another one, or one that is read-only, the law would be recompiled within a cycle
        q_cmd, focus = np.array(q_cmd, dtype=np.float64), np.array(p_focus, dtype=np.float64)
        speed = float(np.linalg.norm(self._tracker.velocity))
        obstacles, radii = self._obstacles(q_leader)
        self.clearance_m = self._law.aim(q_cmd, focus, speed, float(desired_distance), obstacles, radii)
        evading = self._emergency.update(self.clearance_m)
        dq = integrate(
            self._law.evasion if evading else self._law.rates,
            q_cmd,
            self.gains.horizon_s,
            self.gains.max_step_s,
            self.limits.max_dq,
        )
        if not evading:
            dq = self._law.keep_looking(dq, q_cmd, *self.limits.reach(dq_last))
        return self.limits.admissible(dq, q_cmd, dq_last)

    def clearance_at(self, q: Array, q_leader: Array) -> float:
        """Least clearance of bounding spheres at two configurations [m], as used by the repulsion (12)."""
        obstacles, radii = self._obstacles(q_leader)
        return self._law.clearance(q, obstacles, radii)

    def _obstacles(self, q_leader: Array | None) -> tuple[Array, Array]:
        """Centres (k, 3) in the world and radii (k,) of the leader's spheres [m]."""
        if self._leader is None or q_leader is None:
            return np.zeros((0, 3)), np.zeros(0)
        return self._leader.at(q_leader), self._leader.radii
