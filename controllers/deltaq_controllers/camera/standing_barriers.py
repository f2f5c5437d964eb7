"""Keeps the increments of a law of forces clear of the robot's own bodies, of the structure and of joint limits.

The repulsion (12) pushes the arm off the leader and the floor, and off nothing else. A law that folds the arm onto
itself is held by the gate. Here the barriers of the quadratic programme bend such an increment: view, distance and roll
change as by the law, and the joints deviate from it.
"""

import math

import numpy as np

from deltaq_controllers.camera.error import CameraPose, look_on, view_jacobians
from deltaq_controllers.camera.qp_follower import MOST_PAIRS, margins_of
from deltaq_controllers.camera.qp_problem import QpGains, QuadraticProgram, Tasks, step
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.camera.subtasks import roll_effects
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.surroundings.barriers import (
    Barriers,
    Braking,
    Keeping,
    barriers_of,
    bounds,
    bounds_met,
)
from deltaq_controllers.surroundings.neighbours import NearPairs, Neighbours
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles

_JOINTS_WEIGHT = 3e-6
"""Of a joint's squared deviation from the law, per mrad: less than view and distance weigh. With a weight thirty times
as great the arm stays folded; a third of it changes nothing."""
_RESTS = 0.1
"""An arm whose joints move by less of their acceleration limits a cycle is at rest."""
_NEAR_M = 0.05
"""An arm that is this near to its distance is no longer stuck [m]."""


class StandingBarriers:
    """Barriers that keep a robot's bodies apart from one another and from the structure.

    Args:
        scene: the cell and the roles of its robots.
        limits: of the robot's increments.
    """

    def __init__(self, scene: Scene, limits: IncrementLimits) -> None:
        gains = self._gains = QpGains()  # margins and prices of barriers; weights and rates of the view
        robots, own, robot = scene.cell.robots, scene.robot_name, scene.robot
        self._limits, self._cycle_s, self._robot = limits, scene.cycle_s, robot
        self._camera = Kinematics(robot, "camera")
        self._neighbours = Neighbours(scene.cell, own, MOST_PAIRS)
        margins = margins_of(self._neighbours, scene.cell.description.gate, gains)
        foreign = self._neighbours.foreign
        # a range of nothing: pairs with other robots are the repulsion's
        self._ranges = np.where(foreign, -np.inf, margins + gains.barrier_range_m)
        self._keeping = Keeping(foreign, margins, np.full_like(margins, gains.barrier_share), 0.0, 1.0)
        self._program = QuadraticProgram(limits.max_ddq, gains.rest_weight, [gains.barrier_price] * 3)
        self._joints = np.concatenate([each.home for each in robots.values()])
        first = sum(each.n for each in list(robots.values())[: list(robots).index(own)])
        self._own = slice(first, first + robot.n)
        self._rates = np.zeros_like(self._joints)
        views = [gains.angle_weight, gains.angle_weight, gains.distance_weight, gains.roll_weight]
        self._weights = np.array([*views, *np.full(robot.n, _JOINTS_WEIGHT)])
        self._is_stuck = False
        self._newest: tuple[Array, Array, Barriers, NearPairs] | None = None
        # compiles everything now
        self.increment(np.ones(robot.n), np.array(robot.home), np.zeros(robot.n), np.ones(3), 1.0)

    def increment(
        self, dq: Array, q: Array, dq_last: Array, focus: Array, desired_distance_m: float
    ) -> Array:
        """`dq` if it keeps all limits and barriers; otherwise an increment that keeps them and changes the view alike.

        Args:
            dq: (n,) increment of the law [rad or m].
            q: (n,) setpoint that it is added to [rad or m].
            dq_last: (n,) increment that led to it [rad or m].
            focus: (3,) point to look at, in the world [m].
            desired_distance_m: from the lens to it [m].
        """
        cycles = brake_cycles(dq_last, self._limits.max_ddq)
        travel = dq_last * (0.5 * (cycles - 1))  # the rest of the present brake
        joints = self._joints.copy()
        joints[self._own] = q + travel
        near = self._neighbours.near(joints, self._ranges)
        slowest, fastest = bounds(self._limits, q, dq_last, cycles)
        braking = Braking(travel, reach=0.5 * (cycles + 2))
        barriers = barriers_of(near, self._keeping, braking, self._rates, slowest, fastest, self._cycle_s)
        self._newest = q, dq, barriers, near
        is_within = (slowest <= dq).all() and (dq <= fastest).all()
        if is_within and (barriers.rows @ dq >= barriers.least).all():
            return dq
        rests = bool((np.abs(dq_last) < _RESTS * self._limits.max_ddq).all())
        tasks = self._tasks(dq, q, focus, desired_distance_m, rests)
        solution = self._program.solve(tasks, slowest, fastest, barriers)
        if solution is None:
            return dq
        self._newest = q, solution[0], barriers, near
        return solution[0]

    @property
    def bounds_met(self) -> tuple[str, ...]:
        """The bounds that held the last increment back, for people; see `Bounded`."""
        return () if self._newest is None else bounds_met(self._robot, *self._newest, self._neighbours.names)

    def _tasks(self, dq: Array, q: Array, focus: Array, desired_distance_m: float, rests: bool) -> Tasks:
        """Change view, distance and roll as the law does, and move the joints as it does.

        The law begins anew in each cycle. Where its first increment leads away from the distance, an arm at rest stays
        there for ever: until it is at its distance, the distance is approached as by the quadratic programme.
        """
        gains = self._gains
        self._camera.update(q)
        pose = CameraPose(self._camera.rotation, self._camera.position, self._camera.twists)
        view = look_on(pose.rotation, pose.position, focus, pose.twists)
        turning, approach = view_jacobians(view, pose.position, focus, pose.twists)
        levelling = roll_effects(pose.rotation, pose.twists[3:])
        rows = np.vstack([turning / view.stretch, approach, levelling, np.eye(len(q))])
        wanted = rows @ dq
        error = view.distance - desired_distance_m
        self._is_stuck = abs(error) > _NEAR_M and (self._is_stuck or (rests and wanted[2] * error < 0.0))
        if self._is_stuck:
            deceleration = gains.zoom_m_s2 * self._cycle_s**2
            zoom = step(abs(error), gains.distance_share, deceleration, gains.brake_share)
            wanted[2] = math.copysign(zoom, error)
        return Tasks(rows, wanted, self._weights)
