"""The velocity field of the camera follower: (9) with the sub-tasks (12), (14) and (15), or (13)."""

from __future__ import annotations

import math

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.error import CameraPose
from deltaq_controllers.camera.gains import FollowerGains, Variants
from deltaq_controllers.camera.law_equations import (
    CameraGoal,
    Decay,
    kept_looking,
    rates,
    with_bounded_zoom,
)
from deltaq_controllers.camera.repulsion import Potential, Repulsion
from deltaq_controllers.camera.subtasks import RollJoint, turns_about_view_axis
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.redundancy import WeightedGradient, emergency_rates
from deltaq_protocol.arrays import Array


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
            variants.angle_law,
            variants.bounded_rates,
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
            Least clearance from obstacles and floor [m].
        """
        self._kinematics.update(q)
        clearance = self._repulsion.approach(self._kinematics, obstacles, radii)
        goal = CameraGoal(focus, focus_speed, desired_distance, self._gains.distance, math.inf)
        share = self._decay.share_of_horizon
        self._goal = (
            with_bounded_zoom(goal, self._pose(), q, self._weights, self._gains, share)
            if self._variants.bounded_rates
            else goal
        )
        return clearance

    def clearance(self, q: Array, obstacles: Array, radii: Array) -> float:
        """Least clearance at `q` (n,) from spheres, as `aim` takes them, and from the floor [m]."""
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
        leave_bounds = self._variants.bounded_rates
        return kept_looking(
            self._pose(), self._goal.focus, self._gains.damping, leave_bounds, dq, reached, slowest, fastest
        )

    def _pose(self) -> CameraPose:
        kinematics = self._kinematics
        return CameraPose(kinematics.rotation, kinematics.position, kinematics.twists)
