"""The velocity field of the camera follower: (9) with the sub-tasks (12), (14) and (15), or (13)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.error import Look, easiest_way_round, look, view_jacobians
from deltaq_controllers.camera.gains import FollowerGains, Variants
from deltaq_controllers.camera.repulsion import Potential, Repulsion
from deltaq_controllers.camera.subtasks import turn_to_level, turns_about_view_axis, view_distance_field
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.redundancy import WeightedGradient, damped_rates, emergency_rates

Array = NDArray[np.float64]


class CameraLaw:
    """Joint rates over virtual time, for a focus, a desired distance and obstacles that stand still.

    Args:
        robot: the robot that carries the camera.
        cycle_s: its cycle [s].
        max_dq: (n,) largest increment of a cycle [rad or m].
        gains: gains of the law.
        variants: corrected, or as printed.
        floor_m: height of the floor to keep clear of, None for none [m].
    """

    def __init__(
        self,
        robot: RobotModel,
        cycle_s: float,
        max_dq: Array,
        gains: FollowerGains,
        variants: Variants,
        floor_m: float | None,
    ) -> None:
        self._gains, self._variants = gains, variants
        self._share_of_horizon = cycle_s / gains.horizon_s
        self._kinematics = Kinematics(robot, "camera")
        self._weights = WeightedGradient(
            robot.lower, robot.upper, gains.limit_scale, gains.damping, variants.one_sided_weights
        )
        potential = Potential(
            gains.repulsion,
            gains.repulsion_range_m,
            gains.repulsion_min_m,
            as_printed=not variants.gradient_repulsion,
        )
        self._repulsion = Repulsion(robot, potential, max_dq, floor_m)
        last = self._kinematics.last
        self._roll_limits = float(robot.lower[last]), float(robot.upper[last])
        self._roll_is_free = turns_about_view_axis(
            self._kinematics.rotation,
            self._kinematics.position,
            self._kinematics.angular[:, last],
            self._kinematics.linear[:, last],
        )
        self._focus: Array = np.zeros(3)
        self._focus_speed = 0.0
        self._desired_distance = 1.0
        self._distance_gain, self._largest_zoom = gains.distance, math.inf

    def aim(
        self,
        q: Array,
        focus: Array,
        focus_speed: float,
        desired_distance: float,
        obstacles: Array,
        radii: Array,
    ) -> float:
        """Set what the field is for, before the integration from `q`.

        Args:
            q: (n,) start of the increment [rad or m].
            focus: (3,) point to look at, in the world [m].
            focus_speed: its speed [m/s].
            desired_distance: d_r of (14) [m].
            obstacles: (k, 3) centres of the spheres to keep clear of, in the world [m].
            radii: (k,) their radii [m].

        Returns:
            Least clearance from obstacles and floor [m].
        """
        self._focus, self._focus_speed = focus, focus_speed
        self._desired_distance = desired_distance
        self._kinematics.update(q)
        clearance = self._repulsion.approach(self._kinematics, obstacles, radii)
        self._tune_distance(q)
        return clearance

    def clearance(self, q: Array, obstacles: Array, radii: Array) -> float:
        """Least clearance at `q` (n,) from spheres, as `aim` takes them, and from the floor [m]."""
        self._kinematics.update(q)
        return self._repulsion.approach(self._kinematics, obstacles, radii)

    def rates(self, q: Array) -> Array:
        """The law (9) at configuration `q` (n,): joint rates over virtual time [rad/s or m/s]."""
        kinematics, last = self._kinematics, self._kinematics.last
        kinematics.update(q)
        view, jacobian, approach = self._look()
        error = min(max(view.distance - self._desired_distance, -self._largest_zoom), self._largest_zoom)
        field = self._repulsion.field(kinematics) + view_distance_field(self._distance_gain, approach, error)
        spin = self._roll_rate(float(q[last]))
        if not self._roll_is_free:
            # the lens is off the axis of the roll joint: only what the other joints can make up for
            field[last] += spin
        rates = self._weights.rates(q, jacobian, self._task_rate(view), field, view.stretch)
        if self._roll_is_free:
            rates[last] += spin
        return rates

    def evasion(self, q: Array) -> Array:
        """The law (13) at configuration `q` (n,): joint rates over virtual time [rad/s or m/s]."""
        self._kinematics.update(q)
        return emergency_rates(self._weights, q, self._repulsion.field(self._kinematics))

    def keep_looking(self, dq: Array, q: Array, slowest: Array, fastest: Array) -> Array:
        """Increment within bounds that moves the view as `dq` does, if there is one.

        Joints that cannot follow `dq` would spoil the view direction, which is the main task; the joints that
        have room left make up for it, and the sub-tasks pay. Before the view turns away from the focus, joints that
        are braked as `dq` asks are braked less, or more, for it.

        Args:
            dq: (n,) wanted increment [rad or m].
            q: (n,) configuration that it starts from [rad or m].
            slowest: (n,) lower bound of the increment [rad or m].
            fastest: (n,) upper bound of the increment [rad or m].
        """
        reached: Array = np.minimum(np.maximum(dq, slowest), fastest)
        if (reached == dq).all():
            return reached
        self._kinematics.update(q)
        view, jacobian, _ = self._look()
        damping = (self._gains.damping * view.stretch) ** 2
        for _ in range(len(dq)):
            missing = jacobian @ (dq - reached)
            free = (reached > slowest) & (reached < fastest)
            if self._variants.bounded_rates and view.direction @ jacobian @ reached > 0.0:
                # the focus would be lost: joints that stand at a bound leave it too, if that is of help
                helpful = missing @ jacobian
                free |= np.where(reached > slowest, helpful < 0.0, helpful > 0.0)
            if not free.any():
                break
            wanted = reached + damped_rates(
                jacobian, free.astype(np.float64), missing, np.zeros_like(dq), damping
            )
            reached = np.minimum(np.maximum(wanted, slowest), fastest)
            if (reached == wanted).all():
                break
        return reached

    def _look(self) -> tuple[Look, Array, Array]:
        """View, task Jacobian (2, n) and speed of the lens towards the focus (n,) where the robot is placed."""
        kinematics = self._kinematics
        view = look(kinematics.rotation, kinematics.position, self._focus)
        if view.undecided:
            at_focus = kinematics.at_point(self._focus)
            way = easiest_way_round(kinematics.rotation, at_focus)
            view = look(kinematics.rotation, kinematics.position, self._focus, way)
        jacobian, approach = view_jacobians(view, kinematics.position, self._focus, kinematics.twists)
        return view, jacobian, approach

    def _task_rate(self, view: Look) -> Array:
        """(2,) wanted rate of psi [1/s]."""
        # (9) as printed: psi decays at k_p, so the angle at k_p sin(angle)
        rate = self._gains.direction * (view.angle if self._variants.angle_law else math.sin(view.angle))
        if self._variants.bounded_rates:
            ahead = self._focus_speed / view.distance
            rate = min(rate, self._bounded(view.angle, self._gains.turn_rad_s2, ahead))
        return (-view.stretch * rate) * view.direction

    def _roll_rate(self, q_last: float) -> float:
        """Rate of the roll joint (15) at its angle `q_last` [rad/s]."""
        kinematics = self._kinematics
        axis = kinematics.angular[:, kinematics.last]
        turn = turn_to_level(kinematics.rotation, axis, q_last, *self._roll_limits)
        rate = self._gains.roll * abs(turn)
        if self._variants.bounded_rates:
            # other joints have to make up for a lens off the axis, and can only do so much
            deceleration = self._gains.spin_rad_s2 if self._roll_is_free else self._gains.turn_rad_s2
            rate = min(rate, self._bounded(abs(turn), deceleration, 0.0))
        return math.copysign(rate, turn)

    def _tune_distance(self, q: Array) -> None:
        """Gain k of (14), and the largest error that it may see without approaching faster than it can brake.

        How far a field along `approach` moves the lens depends on what the camera task and the joint limits
        leave of it, the mobility. A gain that makes up for it gives the view distance one and the same rate.
        """
        gains = self._gains
        if not self._variants.bounded_rates:
            self._distance_gain, self._largest_zoom = gains.distance, math.inf
            return
        view, jacobian, approach = self._look()
        error = view.distance - self._desired_distance
        towards = math.copysign(1.0, error) * approach
        moved = self._weights.rates(q, jacobian, np.zeros(2), towards, view.stretch)
        mobility = max(float(towards @ moved), gains.min_mobility_m2)
        self._distance_gain = gains.distance / mobility
        rate = self._bounded(abs(error), gains.zoom_m_s2, self._focus_speed)
        self._largest_zoom = rate / gains.distance

    def _bounded(self, error: float, deceleration: float, ahead: float) -> float:
        """Largest rate over virtual time from which the approach of an error can still be braked.

        In one cycle the increment covers what the whole horizon does, so real rates are to rates over
        virtual time as the horizon is to the cycle. `ahead` is the rate at which the target itself moves.
        """
        return self._share_of_horizon * (ahead + math.sqrt(2.0 * deceleration * error))
