"""The equations of the camera law, compiled: (9) with the sub-tasks (12), (14) and (15).

Joint rates are over virtual time, per second of the horizon that an increment is integrated over.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.camera.error import CameraPose, Look, look_on, view_jacobians
from deltaq_controllers.camera.gains import FollowerGains
from deltaq_controllers.camera.subtasks import RollJoint, turn_to_level, view_distance_field
from deltaq_controllers.redundancy import WeightedGradient, damped_rates, weighted_rates
from deltaq_protocol.arrays import Array


class CameraGoal(NamedTuple):
    """What the field is for.

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
    """How fast the errors of (9) and (15) decay; a choice of `FollowerGains` and `Variants`, since each costs time.

    Attributes:
        direction, roll, turn_rad_s2, spin_rad_s2, angle_law, bounded_rates: as there.
        share_of_horizon: the cycle by the virtual horizon.
    """

    direction: float
    roll: float
    turn_rad_s2: float
    spin_rad_s2: float
    angle_law: bool
    bounded_rates: bool
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
    # (9) as printed: psi decays at k_p, so the angle at k_p sin(angle)
    rate = decay.direction * (view.angle if decay.angle_law else math.sin(view.angle))
    if decay.bounded_rates:
        ahead = focus_speed / view.distance
        rate = min(rate, _bounded(view.angle, decay.turn_rad_s2, ahead, decay.share_of_horizon))
    return (-view.stretch * rate) * view.direction


@compiled
def _roll_rate(pose: CameraPose, q_last: float, roll_joint: RollJoint, decay: Decay) -> float:
    """Rate of the roll joint (15) at its angle `q_last` [rad/s]."""
    axis = pose.twists[3:, roll_joint.number]
    turn = turn_to_level(pose.rotation, axis, q_last, roll_joint.lower, roll_joint.upper)
    rate = decay.roll * abs(turn)
    if decay.bounded_rates:
        # other joints have to compensate for a lens off the axis, within their limits
        deceleration = decay.spin_rad_s2 if roll_joint.is_free else decay.turn_rad_s2
        rate = min(rate, _bounded(abs(turn), deceleration, 0.0, decay.share_of_horizon))
    return math.copysign(rate, turn)


@compiled
def with_bounded_zoom(
    goal: CameraGoal,
    pose: CameraPose,
    q: Array,
    weights: WeightedGradient,
    gains: FollowerGains,
    share_of_horizon: float,
) -> CameraGoal:
    """The goal with a gain k of (14), and a largest error for it, such that it can always brake.

    How far a field along `approach` moves the lens depends on what the camera task and the joint limits
    leave of it, the mobility. A gain that compensates for it gives the view distance the same rate everywhere.
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

    In one cycle the increment covers what the whole horizon does, so real rates are to rates over
    virtual time as the horizon is to the cycle. `ahead` is the rate at which the target itself moves.
    """
    return share_of_horizon * (ahead + math.sqrt(2.0 * deceleration * error))


@compiled
def kept_looking(
    pose: CameraPose,
    focus: Array,
    damping: float,
    leave_bounds: bool,
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
        if leave_bounds and (view.direction * _moved(jacobian, reached)).sum() > 0.0:
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
