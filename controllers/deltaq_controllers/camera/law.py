"""The velocity field of the camera follower: (9) with the sub-tasks (12), (14) and (15), or (13)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.error import CameraPose, Look, look_on, view_jacobians
from deltaq_controllers.camera.repulsion import Potential, Repulsion
from deltaq_controllers.camera.subtasks import (
    RollJoint,
    turn_to_level,
    turns_about_view_axis,
    view_distance_field,
)
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.redundancy import (
    DEGREES,
    WeightedGradient,
    damped_rates,
    emergency_rates,
    weighted_rates,
)
from deltaq_protocol.arrays import Array


class FollowerGains(NamedTuple):
    """Gains of the follower. Rates are per second of the virtual horizon.

    Attributes:
        direction: k_p of (9) [1/s].
        distance: rate of the view distance error [1/s]; k of (14) is this over the mobility [m^2/rad^2].
        min_mobility_m2: mobility below which the view distance is given up more and more [m^2/rad^2].
        roll: k_c of (15) [1/s].
        repulsion: eta of (12) as corrected [m^3 rad/s].
        repulsion_range_m: rho_0 of (12) [m].
        repulsion_min_m: clearance at which the repulsion stops growing [m].
        emergency_on_m: clearance below which (13) takes over [m].
        emergency_off_m: clearance above which (9) takes over again [m].
        limit_scale: s_w of the weights (10) [rad].
        damping: ratio of view angle to joint angle at which the damping of (7) halves the task rate.
        horizon_s: virtual horizon of one increment [s].
        max_step_s: longest Runge-Kutta step [s].
        turn_rad_s2: deceleration of the view angle that approaching the focus counts on [rad/s^2].
        zoom_m_s2: deceleration of the view distance that approaching the desired one counts on [m/s^2].
        spin_rad_s2: deceleration of the roll that levelling the picture counts on [rad/s^2].
    """

    direction: float = 30.0
    distance: float = 25.0
    min_mobility_m2: float = 0.05
    roll: float = 15.0
    repulsion: float = 2e-3
    repulsion_range_m: float = 0.3
    repulsion_min_m: float = 0.03
    emergency_on_m: float = 0.08
    emergency_off_m: float = 0.12
    limit_scale: float = DEGREES
    damping: float = 0.03
    horizon_s: float = 0.06
    max_step_s: float = 0.06
    turn_rad_s2: float = 10.0
    zoom_m_s2: float = 2.0
    spin_rad_s2: float = 30.0


# The equations, compiled. Joint rates are over virtual time, per second of the horizon of an increment.


class CameraGoal(NamedTuple):
    """The goal of the field.

    Attributes:
        focus: (3,) point to look at, in the world [m].
        focus_speed: its speed [m/s].
        desired_distance: d_r of (14) [m].
        distance_gain: k of (14) [1/(m s)].
        largest_zoom: largest error that (14) may see [m].
    """

    focus: Array
    focus_speed: float
    desired_distance: float
    distance_gain: float
    largest_zoom: float


class Decay(NamedTuple):
    """How fast the errors of (9) and (15) decay; a choice of `FollowerGains`, since each costs time.

    Attributes:
        direction, roll, turn_rad_s2, spin_rad_s2: as there.
        share_of_horizon: the cycle by the virtual horizon.
    """

    direction: float
    roll: float
    turn_rad_s2: float
    spin_rad_s2: float
    share_of_horizon: float


@compiled
def rates(
    pose: CameraPose,
    q: Array,
    goal: CameraGoal,
    weights: WeightedGradient,
    decay: Decay,
    roll_joint: RollJoint,
    repulsion: Array,
) -> Array:
    """The law (9) with the sub-tasks (12), (14) and (15): joint rates (n,) over virtual time [rad/s or m/s]."""
    view = look_on(pose.rotation, pose.position, goal.focus, pose.twists)
    jacobian, approach = view_jacobians(view, pose.position, goal.focus, pose.twists)
    error = min(max(view.distance - goal.desired_distance, -goal.largest_zoom), goal.largest_zoom)
    field = repulsion + view_distance_field(goal.distance_gain, approach, error)
    last = roll_joint.number
    spin = _roll_rate(pose, q[last], roll_joint, decay)
    if not roll_joint.is_free:
        # the lens is off the axis of the roll joint: only as much as the other joints can compensate
        field[last] += spin
    task = _task_rate(view, goal.focus_speed, decay)
    rates = weighted_rates(weights, q, jacobian, task, field, view.stretch)
    if roll_joint.is_free:
        rates[last] += spin
    return rates


@compiled
def _task_rate(view: Look, focus_speed: float, decay: Decay) -> Array:
    """(2,) wanted rate of psi [1/s]."""
    # the angle decays at k_p; as (9) is printed psi would, and the angle like its sine
    ahead = focus_speed / view.distance
    bound = _bounded(view.angle, decay.turn_rad_s2, ahead, decay.share_of_horizon)
    rate = min(decay.direction * view.angle, bound)
    return (-view.stretch * rate) * view.direction


@compiled
def _roll_rate(pose: CameraPose, q_last: float, roll_joint: RollJoint, decay: Decay) -> float:
    """Rate of the roll joint (15) at its angle `q_last` [rad/s]."""
    axis = pose.twists[3:, roll_joint.number]
    turn = turn_to_level(pose.rotation, axis, q_last, roll_joint.lower, roll_joint.upper)
    # other joints have to compensate for a lens off the axis, within their limits
    deceleration = decay.spin_rad_s2 if roll_joint.is_free else decay.turn_rad_s2
    bound = _bounded(abs(turn), deceleration, 0.0, decay.share_of_horizon)
    return math.copysign(min(decay.roll * abs(turn), bound), turn)


@compiled
def with_bounded_zoom(
    goal: CameraGoal,
    pose: CameraPose,
    q: Array,
    weights: WeightedGradient,
    gains: FollowerGains,
    share_of_horizon: float,
) -> CameraGoal:
    """The goal with a gain k of (14) and a largest error from which it can always brake.

    How far a field along `approach` moves the lens depends on the freedom that camera task and joint limits leave,
    the mobility. A gain that compensates for it gives the view distance the same rate everywhere.
    """
    view = look_on(pose.rotation, pose.position, goal.focus, pose.twists)
    jacobian, approach = view_jacobians(view, pose.position, goal.focus, pose.twists)
    error = view.distance - goal.desired_distance
    towards = math.copysign(1.0, error) * approach
    moved = weighted_rates(weights, q, jacobian, np.zeros(2), towards, view.stretch)
    mobility = max((towards * moved).sum(), gains.min_mobility_m2)
    rate = _bounded(abs(error), gains.zoom_m_s2, goal.focus_speed, share_of_horizon)
    return CameraGoal(
        goal.focus, goal.focus_speed, goal.desired_distance, gains.distance / mobility, rate / gains.distance
    )


@compiled
def _bounded(error: float, deceleration: float, ahead: float, share_of_horizon: float) -> float:
    """Largest rate over virtual time from which the approach of an error can still be braked.

    One increment covers the whole horizon, so real rates are rates over virtual time times horizon over cycle.
    `ahead` is the rate at which the target itself moves.
    """
    return share_of_horizon * (ahead + math.sqrt(2.0 * deceleration * error))


@compiled
def kept_looking(
    pose: CameraPose,
    focus: Array,
    damping: float,
    dq: Array,
    clipped: Array,
    slowest: Array,
    fastest: Array,
) -> Array:
    """`CameraLaw.keep_looking` from `dq` (n,) as it was `clipped` (n,) to its bounds."""
    view = look_on(pose.rotation, pose.position, focus, pose.twists)
    jacobian, _ = view_jacobians(view, pose.position, focus, pose.twists)
    nothing = np.zeros_like(dq)
    reached = clipped
    for _ in range(len(dq)):
        missing = _moved(jacobian, dq - reached)
        free = (reached > slowest) & (reached < fastest)
        if (view.direction * _moved(jacobian, reached)).sum() > 0.0:
            # the focus would be lost: joints at a bound leave it too, if that helps
            helpful = missing[0] * jacobian[0] + missing[1] * jacobian[1]
            free |= np.where(reached > slowest, helpful < 0.0, helpful > 0.0)
        if not free.any():
            break
        wanted = reached + damped_rates(
            jacobian, free.astype(np.float64), missing, nothing, (damping * view.stretch) ** 2
        )
        reached = np.minimum(np.maximum(wanted, slowest), fastest)
        if (reached == wanted).all():
            break
    return reached


@compiled
def _moved(jacobian: Array, dq: Array) -> Array:
    """(2,) change of psi by an increment (n,)."""
    return np.array([(jacobian[0] * dq).sum(), (jacobian[1] * dq).sum()])


class CameraLaw:
    """Joint rates over virtual time, for a focus, a desired distance and fixed obstacles.

    Args:
        robot: the robot that carries the camera.
        cycle_s: its cycle [s].
        max_dq: (n,) largest increment of a cycle [rad or m].
        gains: gains of the law.
        floor_m: height of the floor to keep clear of, None for none [m].
    """

    def __init__(
        self,
        robot: RobotModel,
        cycle_s: float,
        max_dq: Array,
        gains: FollowerGains,
        floor_m: float | None,
    ) -> None:
        self._gains = gains
        self._kinematics = Kinematics(robot, "camera")
        self._weights = WeightedGradient(robot.lower, robot.upper, gains.limit_scale, gains.damping)
        potential = Potential(gains.repulsion, gains.repulsion_range_m, gains.repulsion_min_m)
        self._repulsion = Repulsion(robot, potential, max_dq, floor_m)
        last = self._kinematics.last
        self._roll_joint = RollJoint(
            last,
            float(robot.lower[last]),
            float(robot.upper[last]),
            turns_about_view_axis(
                self._kinematics.rotation,
                self._kinematics.position,
                self._kinematics.angular[:, last],
                self._kinematics.linear[:, last],
            ),
        )
        self._decay = Decay(
            gains.direction,
            gains.roll,
            gains.turn_rad_s2,
            gains.spin_rad_s2,
            cycle_s / gains.horizon_s,
        )
        self._goal = CameraGoal(np.zeros(3), 0.0, 1.0, gains.distance, math.inf)
        self._warm_up(np.array(robot.home), max_dq)

    def _warm_up(self, q: Array, max_dq: Array) -> None:
        """Compile everything now, because the first cycle, and the first obstacle, leave no time for it."""
        lens = self._kinematics.position
        self.aim(q, lens + 1.0, 0.0, 1.0, lens[None], np.ones(1))
        self.rates(q)
        self.evasion(q)
        self.keep_looking(2.0 * max_dq, q, -max_dq, max_dq)

    def aim(
        self,
        q: Array,
        focus: Array,
        focus_speed: float,
        desired_distance: float,
        obstacles: Array,
        radii: Array,
    ) -> float:
        """Set the goal of the field, before the integration from `q`.

        Args:
            q: (n,) start of the increment [rad or m].
            focus: (3,) point to look at, in the world [m].
            focus_speed: its speed [m/s].
            desired_distance: d_r of (14) [m].
            obstacles: (k, 3) centres of the spheres to keep clear of, in the world [m].
            radii: (k,) their radii [m].

        Returns:
            Least clearance from obstacles [m].
        """
        self._kinematics.update(q)
        clearance = self._repulsion.approach(self._kinematics, obstacles, radii)
        goal = CameraGoal(focus, focus_speed, desired_distance, self._gains.distance, math.inf)
        share = self._decay.share_of_horizon
        self._goal = with_bounded_zoom(goal, self._pose(), q, self._weights, self._gains, share)
        return clearance

    def clearance(self, q: Array, obstacles: Array, radii: Array) -> float:
        """Least clearance at `q` (n,) from spheres, as `aim` takes them [m]."""
        self._kinematics.update(q)
        return self._repulsion.approach(self._kinematics, obstacles, radii)

    def rates(self, q: Array) -> Array:
        """The law (9) at configuration `q` (n,): joint rates over virtual time [rad/s or m/s]."""
        self._kinematics.update(q)
        return rates(
            self._pose(),
            q,
            self._goal,
            self._weights,
            self._decay,
            self._roll_joint,
            self._repulsion.field(self._kinematics),
        )

    def evasion(self, q: Array) -> Array:
        """The law (13) at configuration `q` (n,): joint rates over virtual time [rad/s or m/s]."""
        self._kinematics.update(q)
        return emergency_rates(self._weights, q, self._repulsion.field(self._kinematics))

    def keep_looking(self, dq: Array, q: Array, slowest: Array, fastest: Array) -> Array:
        """Increment within bounds that moves the view as `dq` does, if there is one.

        Joints that cannot follow `dq` would disturb the view direction, which is the main task; the joints that
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
        return kept_looking(
            self._pose(), self._goal.focus, self._gains.damping, dq, reached, slowest, fastest
        )

    def _pose(self) -> CameraPose:
        kinematics = self._kinematics
        return CameraPose(kinematics.rotation, kinematics.position, kinematics.twists)
