"""Weights and margins of the quadratic programme."""

from __future__ import annotations

from typing import NamedTuple

from deltaq_controllers.redundancy import DEGREES


class QpGains(NamedTuple):
    """Gains of the programme, in order of priority.

    Limits of speed, acceleration and position are constraints without slack: nothing outweighs them. Then come
    the barriers, whose slack costs in proportion (`barrier_price`), so that the camera cannot buy any of it
    while there is an alternative. The tasks are least squares in one sum. Angle comes first, at a higher price than
    the braking distance of others; two decades below it evasion, distance and joint margin, of equal weight: the
    follower backs off neither along the view axis nor into a limit while it can evade sideways. Two decades below
    that roll, and the joint margin where no robot is near: without it the freedom that the view leaves drifts into
    limits, from which a later change of distance finds no way. Last of all rest of the joints.

    Attributes:
        clear_of_others_m: least distance from other robots, beyond the gate's stop distance [m].
        clear_of_structure_m: least distance from the structure, likewise [m].
        clear_of_self_m: least distance between the robot's own bodies, beyond the gate's for these [m].
        barrier_range_m: beyond its barrier, how far a pair of bodies is taken into account [m].
        others_range_m: this range for bodies of other robots [m].
        barrier_share: fraction of the remaining distance that one cycle may use up.
        others_share: this fraction for other robots; smaller, so that evading begins early and gently.
        reaction_s: time for which another robot is expected to keep its speed [s].
        others_brake_m_s2: deceleration that is expected of another robot [m/s^2].
        barrier_price: cost of slack per m, on the scale of the tasks' costs; above what the largest error can pay.
        reserve_price: this cost for the braking distance of other robots, beyond the least distance from them.
        evasion: eta of the repulsion (12) off other robots [m^3 rad/s].
        evasion_range_m: rho_0 of (12) [m].
        evasion_min_m: distance at which the repulsion stops growing [m].
        limit_scale: s_w of the weights (10) that keep the repulsion from pressing joints to their limits [rad].
        room: k of the rates -k H, H of (11), at which joints leave their limits [rad^2/s or m^2/s].
        room_rate: largest size of these rates [rad/s or m/s].
        angle_weight, evasion_weight, distance_weight, room_weight, posture_weight, roll_weight, rest_weight: of the
            squares: per mm of the focus' path at 1 m for angle, per mrad for evasion, room, posture and roll, per mm
            for distance, per acceleration limit for rest. The joints' margin weighs `room_weight` while another robot
            is near, and else `posture_weight`.
        angle_share, distance_share, roll_share: part of an error that a cycle takes away, near the goal.
        brake_share: part of the possible deceleration that approaching a goal counts on.
        zoom_m_s2: largest deceleration of the view distance that is counted on [m/s^2].
        spin_rad_s2: deceleration of the roll that is counted on [rad/s^2].
    """

    clear_of_others_m: float = 0.05
    clear_of_structure_m: float = 0.03
    clear_of_self_m: float = 0.01
    barrier_range_m: float = 0.25
    others_range_m: float = 0.5
    barrier_share: float = 0.2
    others_share: float = 0.06
    reaction_s: float = 0.2
    others_brake_m_s2: float = 2.0
    barrier_price: float = 1e7
    reserve_price: float = 3e3
    evasion: float = 1e-2
    evasion_range_m: float = 0.3
    evasion_min_m: float = 0.03
    limit_scale: float = DEGREES
    room: float = 0.04
    room_rate: float = 0.7
    angle_weight: float = 1.0
    evasion_weight: float = 1e-2
    distance_weight: float = 1e-2
    room_weight: float = 1e-2
    posture_weight: float = 1e-4
    roll_weight: float = 1e-4
    rest_weight: float = 1e-5
    angle_share: float = 0.5
    distance_share: float = 0.3
    roll_share: float = 0.15
    brake_share: float = 0.6
    zoom_m_s2: float = 3.0
    spin_rad_s2: float = 30.0
