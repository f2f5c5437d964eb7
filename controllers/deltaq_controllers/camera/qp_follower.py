"""The camera follower as one quadratic programme per cycle.

It does what the paper's law (9) does by projection, weights and gains: limits are constraints that account for the
robot's brake, clearance is a barrier that accounts for the other robot's motion, and the view's tasks share the
remaining freedom by their weights (`QpGains`). There is no null space: every task is a row.

    angle      (J_t / stretch) dq = -step(theta) e - (P p' / stretch) T      (3)-(5), in rad
    distance   -u . J_v dq        =  step(d) - u . p' T                      (14)
    roll       (d roll / d q) dq  =  step(roll)                              (15)
    evasion    f . dq             =  |W^-1 F_rep| T,  f along W^-1 F_rep     (12)
    room       g . dq             =  |G| T,  g along G = -k H                   (11)
    barrier    n . J dq >= n . v T - gamma (d - barrier) - s

T is the cycle, p' the focus' and v the other body's estimated velocity. `step` takes a fraction of an error, but never
more than leaves room to brake with the acceleration that the joints have in that direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.description import GateDescription
from deltaq_controllers.camera.error import CameraPose, view_angle
from deltaq_controllers.camera.qp_problem import (
    Aim,
    Evasion,
    QpGains,
    QuadraticProgram,
    TaskGains,
    Tasks,
    view_tasks,
)
from deltaq_controllers.camera.repulsion import Obstacles, Potential, Repulsion
from deltaq_controllers.camera.scene import Scene, focus_of
from deltaq_controllers.camera.subtasks import RollJoint
from deltaq_controllers.interface import LastIncrement, RobotView, View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.redundancy import WeightedGradient, inverse_weights, limit_gradient
from deltaq_controllers.surroundings.barriers import (
    Barriers,
    Braking,
    Keeping,
    barriers_of,
    bounds,
    bounds_met,
)
from deltaq_controllers.surroundings.neighbours import NearPairs, Neighbours
from deltaq_controllers.surroundings.setpoints import Foreseen, OtherRobots
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles

MOST_PAIRS = 16
"""Pairs of bodies that one programme takes into account: the nearest in proportion to their range."""


class Withdrawal(NamedTuple):
    """A task that withdraws the arm, and the weights of all tasks during it."""

    evasion: Evasion
    gains: TaskGains


class QpFollower:
    """Looks at the leader's tool, or at a fixed point, from a desired distance, keeping clear of everything.

    Until the first state of the leader the robot is brought to rest.

    Args:
        scene: the cell and the roles of its robots.
        desired_distance_m: desired view distance; may be changed at any time [m].
        focus: (3,) fixed point in the world to look at in place of the leader's tool [m].
        gains: weights and margins.

    Attributes:
        desired_distance_m, focus, gains: as given; the first two may be changed at any time.
        aim_offset_m: (3,) point of the leader's tool to look at, in the tool's frame; may be changed too [m].
        limits: limits of the increments.
        evades_below_m: clearance from other robots below which barriers act [m].
        barrier_m: least distance from other robots at any relative motion [m].
        slack_m: (3,) by how much the last increment fell short of the barriers to other robots, of all other
            barriers, and of what other robots need to brake in [m].
        unsolved: cycles in which the solver gave no answer and the robot braked.

    Raises:
        RobotModelError: the robot carries no camera.
    """

    def __init__(
        self,
        scene: Scene,
        desired_distance_m: float,
        focus: Array | None = None,
        gains: QpGains | None = None,
    ) -> None:
        robot, cycle_s = scene.robot, scene.cycle_s
        self.desired_distance_m, self.focus, self.gains = desired_distance_m, focus, gains or QpGains()
        self.aim_offset_m: Array = np.array(scene.aim_offset_m)
        self.limits = IncrementLimits.of(robot, cycle_s)
        self.barrier_m = scene.cell.description.gate.stop_distance_m + self.gains.clear_of_others_m
        self.evades_below_m = self.barrier_m + self.gains.others_range_m
        self.slack_m, self.unsolved = np.zeros(3), 0
        self._newest: tuple[Array, Array, Barriers, NearPairs] | None = None
        self._scene, self._cycle_s = scene, cycle_s
        self._last = LastIncrement(self.limits.max_ddq)
        self._camera = Kinematics(robot, "camera")
        last = self._camera.last
        self._roll_joint = RollJoint(last, self.limits.lower[last], self.limits.upper[last], is_free=False)
        self._leader = Kinematics(scene.leader, "tool")
        self._others = OtherRobots(scene.cell, scene.robot_name)
        self._neighbours = Neighbours(scene.cell, scene.robot_name, MOST_PAIRS)
        foreign, gains = self._neighbours.foreign, self.gains
        margins = margins_of(self._neighbours, scene.cell.description.gate, gains)
        self._ranges = margins + np.where(foreign, gains.others_range_m, gains.barrier_range_m)
        shares = np.where(foreign, gains.others_share, gains.barrier_share)
        self._keeping = Keeping(foreign, margins, shares, gains.reaction_s, gains.others_brake_m_s2)
        prices = [gains.barrier_price, gains.barrier_price, gains.reserve_price]
        self._program = QuadraticProgram(self.limits.max_ddq, gains.rest_weight, prices)
        potential = Potential(gains.evasion, gains.evasion_range_m, gains.evasion_min_m)
        self._repulsion = Repulsion(robot, potential, np.zeros(robot.n), floor_m=0.0)
        self._limit_weights = WeightedGradient(robot.lower, robot.upper, gains.limit_scale, 0.0)
        # with no robot near, the joints' margin gives way to the distance
        self._gains_near = TaskGains.of(gains)
        self._gains_alone = self._gains_near._replace(room_weight=gains.posture_weight)
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile everything now, because the first cycle, and the first attack, leave no time for it."""
        robots, own = self._scene.cell.robots, self._scene.robot_name
        at_home = {name: RobotView(0, 0.0, robot.home, robot.home) for name, robot in robots.items()}
        self._others.update(View(at_home[own], at_home))
        q = np.array(robots[own].home)
        near = self._neighbours.near(self._others.joined(q, {}), np.full_like(self._ranges, 1e3))
        tasks = self._tasks(q, np.zeros_like(q), *self._focus_ahead(), evade=True)
        reach = bounds(self.limits, q, np.zeros_like(q), 1)
        self._program.solve(tasks, *reach, self._barriers(near, np.zeros_like(q), 1, *reach))
        self._others = OtherRobots(self._scene.cell, self._scene.robot_name)

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        # one kind of array: for a read-only one the programme's parts would be recompiled within a cycle
        q, dq_last = np.array(view.own.q_cmd, dtype=np.float64), self._last.update(view.own)
        if self._scene.leader_name not in view.others:
            return self.limits.admissible(np.zeros_like(q), q, dq_last)
        self._others.update(view)
        focus, velocity = self._focus_ahead()
        cycles = brake_cycles(dq_last, self.limits.max_ddq)
        # the rest of the present brake
        travel = dq_last * (0.5 * (cycles - 1))
        others = self._others.ahead()
        near = self._neighbours.near(self._others.joined(q + travel, others), self._ranges)
        foreign = self._neighbours.foreign[near.pairs]
        tasks = self._tasks(q, dq_last, focus, velocity, evade=True in foreign)
        slowest, fastest = bounds(self.limits, q, dq_last, cycles)
        barriers = self._barriers(near, travel, cycles, slowest, fastest)
        solution = self._program.solve(tasks, slowest, fastest, barriers)
        if solution is None:
            self.unsolved += 1
            return self.limits.admissible(np.zeros_like(q), q, dq_last)
        dq, self.slack_m = solution
        self._newest = q, dq, barriers, near
        return self.limits.admissible(dq, q, dq_last)

    @property
    def bounds_met(self) -> tuple[str, ...]:
        """The bounds that held the last increment back, for people; see `Bounded`."""
        if self._newest is None:
            return ()
        return bounds_met(self._scene.robot, *self._newest, self._neighbours.names)

    @property
    def leader_seen(self) -> Foreseen:
        """How the leader is seen, and how old its state is."""
        return self._others.named(self._scene.leader_name)

    def errors(self, q: Array, q_leader: Array) -> tuple[float, float]:
        """View angle error [rad] and view distance less the desired one [m], at measured configurations."""
        T_world_camera = self._scene.robot.camera_pose(q)
        focus = self.focus
        if focus is None:
            focus = focus_of(self._scene.leader.forward(q_leader), self.aim_offset_m)
        lens = T_world_camera[:3, 3]
        distance = float(np.linalg.norm(focus - lens))
        return view_angle(T_world_camera[:3, :3], lens, focus), distance - self.desired_distance_m

    def clearance(self, q: Array, q_leader: Array) -> float:
        """Least distance from other robots [m]; `evades_below_m` if they are farther away."""
        neighbours = self._neighbours
        near = neighbours.near(
            self._others.joined(q, {self._scene.leader_name: q_leader}),
            np.where(neighbours.foreign, self.evades_below_m, -np.inf),
        )
        return float(near.distance.min(initial=self.evades_below_m))

    def _focus_ahead(self) -> tuple[Array, Array]:
        """(3,) the focus when the last increment arrives [m], and its velocity (3,) [m/s]."""
        if self.focus is not None:
            return np.array(self.focus, dtype=np.float64), np.zeros(3)
        leader = self._others.named(self._scene.leader_name)
        self._leader.update(leader.ahead(-self._cycle_s))  # the start of the increment
        focus = self._leader.position + self._leader.rotation @ self.aim_offset_m
        return focus, self._leader.at_point(focus) @ leader.velocity

    def _tasks(self, q: Array, dq_last: Array, focus: Array, velocity: Array, evade: bool) -> Tasks:
        """The goal of the increment, at configuration `q` (n,)."""
        camera = self._camera
        camera.update(q)
        retreat = self._retreat(q, dq_last, focus, evade)
        return view_tasks(
            CameraPose(camera.rotation, camera.position, camera.twists),
            q,
            Aim(focus, velocity, float(self.desired_distance_m)),
            retreat.evasion,
            retreat.gains,
            self._roll_joint,
            self.limits.max_ddq,
            self._cycle_s,
        )

    def _retreat(self, q: Array, _dq_last: Array, _focus: Array, evade: bool) -> Withdrawal:
        """The evasion at `q` (n,), reached by `_dq_last` (n,), while a robot is near."""
        away = self._evasion(q) if evade else np.zeros_like(q)
        size = math.sqrt(float((away * away).sum()))
        # with a fixed target no joint moves: the free joints do not drift
        room = self._room(q) if evade or self.focus is None else np.zeros_like(q)
        evasion = Evasion((away / max(size, 1e-9))[None], np.array([size]), room)
        return Withdrawal(evasion, self._gains_near if evade else self._gains_alone)

    def _kept(self) -> Keeping:
        """How distances are kept in this cycle."""
        return self._keeping

    def _barriers(
        self, near: NearPairs, travel: Array, cycles: int, slowest: Array, fastest: Array
    ) -> Barriers:
        """Barriers of the distances in range, while a brake from an increment (n,) has so many cycles left."""
        # the brake that follows an increment ends `reach * dq` away, as the gate will see it too; at most
        # a cycle is added to it
        braking = Braking(travel, reach=0.5 * (cycles + 2))
        rates = self._others.rates()
        return barriers_of(near, self._kept(), braking, rates, slowest, fastest, self._cycle_s)

    def _evasion(self, q: Array) -> Array:
        """(n,) W^-1 F_rep of (12), off the floor and where the other robots will be [rad/s or m/s].

        The positions extrapolated by `reaction_s` count: the barriers keep these free, and a follower that begins
        to slide aside only there is held by the gate.
        """
        obstacles = Obstacles(*self._others.spheres_ahead(self.gains.reaction_s))
        force = self._repulsion.field_of(self._camera, obstacles)
        return inverse_weights(self._limit_weights, q, force) * force

    def _room(self, q: Array) -> Array:
        """(n,) rates back from the limits, along -H of (11) [rad/s or m/s].

        A joint at its limit blocks the retreat. To turn round before it, and slip past the attacker where the evasion
        allows it, takes more margin than the weights of the evasion keep. And what the view leaves free drifts: with
        A3 and A5 at their limits a camera that is near has no way back to a greater distance.
        """
        back = -self.gains.room * limit_gradient(q, self.limits.lower, self.limits.upper)
        return back * min(1.0, self.gains.room_rate / max(float(np.linalg.norm(back)), 1e-9))


def margins_of(pairs: Neighbours, gate: GateDescription, gains: QpGains) -> Array:
    """(p,) least distance of each pair of bodies that barriers keep [m]."""
    other = np.where(pairs.foreign, gains.clear_of_others_m, gains.clear_of_structure_m)
    stop = np.where(pairs.same, gate.self_stop_distance_m, gate.stop_distance_m)
    margins: Array = stop + np.where(pairs.same, gains.clear_of_self_m, other)
    return margins
