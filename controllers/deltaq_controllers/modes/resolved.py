"""A mode whose joints follow from tasks, by one quadratic programme per cycle (`programme`).

A mode names the tasks: motions of the hands, and joints that are driven by name. The rest is the same for all: the
acceleration towards the command, the end of a motion, and the limiting factor.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes import programme
from deltaq_controllers.modes.conditioning import (
    GLANCE,
    LOST,
    WATCHED_M,
    kept_share,
    least_motions,
    ramped,
)
from deltaq_controllers.modes.hands import Hands, HeldObject, displacement, kept_together_while_braked, turned
from deltaq_controllers.modes.interface import (
    Advance,
    Conditioning,
    Instant,
    Limitation,
    Motion,
    TeleoperationMode,
    of_conditioning,
    of_joint,
    of_pair,
    of_speed,
)
from deltaq_controllers.modes.programme import POSITION, SPEED, Box, Solution, admits, can_rest, increment_box
from deltaq_controllers.surroundings.barriers import Barriers
from deltaq_controllers.surroundings.neighbours import NearPairs
from deltaq_controllers.surroundings.surroundings import Near
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles

# The constraint of a solved programme that keeps the pace below the commanded one.

_PRESSES = 1e-9
"""Force of a constraint below which it does not bind."""


def binding(robot: RobotModel, instant: Instant, found: Solution, box: Box, near: Near) -> Limitation | None:
    """The constraint with the largest multiplier, in words; None for acceleration, which passes.

    Args:
        robot: the robot.
        instant: of the programme.
        found: its solution.
        box: the bounds of the joints in it.
        near: the barriers in it.
    """
    if len(found.barrier_forces) and found.barrier_forces.max() > max(
        _PRESSES, np.abs(found.joint_forces).max()
    ):
        assert instant.surroundings is not None  # they have barriers
        place = int(near.barriers.places[np.argmax(found.barrier_forces)])
        pair, kept_m = instant.surroundings.kept(int(near.pairs.pairs[place]))
        return of_pair(pair, float(near.pairs.distance[place]), kept_m)
    names = robot.joint_names
    for joint in np.argsort(-np.abs(found.joint_forces)).tolist():
        force = found.joint_forces[joint]
        if abs(force) < _PRESSES:
            return None
        why = (box.why_fastest if force > 0.0 else box.why_slowest)[joint]
        if why == SPEED:
            return of_speed(names[joint])
        if why == POSITION:
            return of_joint(names[joint], float(instant.q_cmd[joint]), bool(robot.revolute[joint]))
    return None


# Where the hands are to be: the line that an operator has them follow, and the way back to it.

TAKEN_BACK_M_S, TAKEN_BACK_RAD_S = 2e-3, 2e-3
"""Greatest rate at which a hand comes back to its line [m/s, rad/s]."""


class Line:
    """The line: the desired poses of the hands in each cycle.

    Attributes:
        is_set: whether there is one.
    """

    def __init__(self) -> None:
        self._rotations: Array | None = None
        self._positions: Array = np.zeros((0, 3))

    @property
    def is_set(self) -> bool:
        """Whether there is a line."""
        return self._rotations is not None

    def begin(self, hands: Hands, held: HeldObject | None = None) -> None:
        """Start the line at the present poses of the hands, or at those that keep the held object."""
        self._rotations, self._positions = hands.rotations.copy(), hands.positions.copy()
        self._keep(held)

    def _keep(self, held: HeldObject | None) -> None:
        if held is not None and self._rotations is not None:
            self._rotations, self._positions = held.placed(self._rotations, self._positions)

    def forget(self) -> None:
        """Drop the line."""
        self._rotations = None

    def back(self, hands: Hands, time_s: float) -> Array:
        """(h, 6) displacement back to the line, clipped to the largest correction of a cycle [m, rad]."""
        assert self._rotations is not None  # begun
        most_m, most_rad = time_s * TAKEN_BACK_M_S, time_s * TAKEN_BACK_RAD_S
        return _back(hands.rotations, hands.positions, self._rotations, self._positions, most_m, most_rad)

    def go(self, way: Array, held: HeldObject | None = None) -> None:
        """Advance the desired poses by displacements (h, 6) [m, rad], keeping the held object."""
        assert self._rotations is not None  # begun
        self._rotations, self._positions = _gone(self._rotations, self._positions, way)
        self._keep(held)


@compiled
def _back(
    rotations: Array,
    positions: Array,
    to_rotations: Array,
    to_positions: Array,
    most_m: float,
    most_rad: float,
) -> Array:
    """`Line.back`."""
    error = displacement(rotations, positions, to_rotations, to_positions)
    for hand in range(len(error)):
        for first, most in ((0, most_m), (3, most_rad)):
            x, y, z = error[hand, first], error[hand, first + 1], error[hand, first + 2]
            share = min(1.0, most / max(math.sqrt(x * x + y * y + z * z), 1e-15))
            for axis in range(first, first + 3):
                error[hand, axis] *= share
    return error


@compiled
def _gone(rotations: Array, positions: Array, way: Array) -> tuple[Array, Array]:
    """Poses after a way (h, 6)."""
    return turned(rotations, way[:, 3:]), positions + way[:, :3]


RAMP_SHARE = 0.5
"""Fraction of each joint's acceleration that an operator's own changes of speed use."""

REVOLUTE_SHARE = 0.25
"""Share of a rad of a revolute joint in the work, where a m of a prismatic one has one."""

SWIFT_RAD_S2, LEAST_SHARE = 4.0, 0.25
"""Acceleration from which on a revolute joint has its full share; a slower one has less, down to this part of it."""

SLOWED = 0.95
"""Pace, or share of the command, below which the operator sees the limiting factor."""

OFF_LINE_M = 1e-6
"""By how much the tasks may leave their line in a cycle for a change of direction [m]."""

_AS_ASKED = 1e-9
"""An increment that differs by less from the requested one was admitted whole [rad or m]."""


class DrivenTasks(NamedTuple):
    """DrivenTasks at a configuration.

    Attributes:
        rows: (r, n) displacement of each per joint displacement, turns as travel; six for each hand, then those of
            driven joints.
        rates: (r,) that are asked for [m/s].
    """

    rows: Array
    rates: Array


class ResolvedMode(TeleoperationMode):
    """The common part of `decoupled`, `coupled` and `self-motion`.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._hands = Hands(robot)
        swift = np.clip(robot.max_acceleration / SWIFT_RAD_S2, LEAST_SHARE, 1.0)
        self._shares = np.where(robot.revolute, REVOLUTE_SHARE * swift, 1.0)
        self._weights = 1.0 / self._shares
        self._units = self._hands.units
        self._line = Line()
        self._asked: Array = np.zeros(robot.n)
        self._going: Array | None = None
        self._motion: Array | None = None
        none, no_index, no_rows = np.zeros(0), np.zeros(0, dtype=np.intp), np.zeros((0, robot.n))
        self._nothing_near = Near(
            Barriers(no_rows, none, no_index, no_index), NearPairs(no_index, none, no_rows, no_rows)
        )

    @abstractmethod
    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        """The tasks of a motion where `_hands` are."""

    def _allowed(self, instant: Instant, motion: Motion) -> float:
        """The share of a motion that the mode's own guarantee allows."""
        del instant, motion
        return 1.0

    def _kept_together(self, instant: Instant, made: Array, rates: Array) -> float:
        """The share of `rates` (r,) up to which the gate can brake hands that go at `made` and hold an object."""
        if instant.held is None:
            return 1.0
        asked, going = float(np.linalg.norm(rates)), float(np.linalg.norm(made))
        if not asked or not going:
            return 1.0
        joints, most = instant.dq_last / instant.cycle_s, self._robot.max_acceleration
        allowed = kept_together_while_braked(self._hands, instant.held, instant.q_cmd, joints, most)
        return min(1.0, allowed * going / asked)

    def _drift(self, q: Array, made: Array) -> Array:
        """(n,) joint rates that are wanted besides tasks that go at rates `made` (r,) [m/s]."""
        del made
        return np.zeros_like(q)

    def _ended(self, motion: Motion, conditioning: Conditioning) -> Limitation:
        """The limitation that is reported when the motion ends for lack of mobility."""
        del motion
        return of_conditioning(self._hands, conditioning)

    def enter(self, q: Array) -> None:
        """The lines of the hands begin at their present poses."""
        self._line.forget()
        self._asked = np.zeros_like(q)
        self._going = self._motion = None

    def advance(self, instant: Instant, asked: Motion) -> Advance:
        """The increment that continues towards the requested motion."""
        q, dq_last, limits = instant.q_cmd, instant.dq_last, instant.limits
        cycles = brake_cycles(dq_last, limits.max_ddq)
        box = increment_box(limits, q, dq_last, instant.dq_before, cycles, instant.max_jerk, instant.cycle_s)
        if not asked and can_rest(box, dq_last, instant.max_jerk):
            self._rest()
            self._going = self._motion = None
            self._asked = np.zeros_like(q)
            return Advance(self._asked)
        if np.abs(dq_last - self._asked).max() > _AS_ASKED:
            self._going = self._motion = None
            self._intervened()
        found = self._towards(instant, asked, box, cycles)
        is_whole = admits(limits, q, found.dq, dq_last)
        self._asked = found.dq if is_whole else limits.admissible(found.dq, q, dq_last)
        return Advance(self._asked, found.limitation)

    def _rest(self) -> None:
        """The robot comes to rest: the next motion begins where the hands are then."""
        self._line.forget()

    def _intervened(self) -> None:
        """The gate limited or held the increment: restart the line at the present poses of the hands."""
        self._line.forget()

    def _towards(self, instant: Instant, asked: Motion, box: Box, cycles: int) -> Advance:
        q, dq_last, limits, cycle_s = instant.q_cmd, instant.dq_last, instant.limits, instant.cycle_s
        hands, line = self._hands, self._line
        hands.place(q)
        if not line.is_set:
            line.begin(hands, instant.held)
        # half a cycle ahead the Jacobian is that of the whole cycle, to second order
        middle = q + 0.5 * dq_last
        error = line.back(hands, cycle_s).ravel()
        hands.update(middle)
        tasks = self._together(self._tasks(asked, instant.held), instant.held)
        back = np.zeros(len(tasks.rates))
        back[: len(error)] = self._units * error
        if self._going is None or len(self._going) != len(tasks.rates):
            # nothing was asked for before, or fewer tasks, or the gate did otherwise
            self._going, self._motion = tasks.rows @ dq_last / cycle_s, None
        made = self._together(DrivenTasks(tasks.rows, self._going), instant.held).rates
        motions = least_motions(tasks.rows, self._shares, tasks.rates, made)
        share, ended = self._allowed(instant, asked), None
        share = min(share, self._kept_together(instant, made, tasks.rates))
        if asked and (motions.lost > LOST or motions.mobility < WATCHED_M):
            direction = motions.asked / max(float(np.linalg.norm(motions.asked)), 1e-12)
            hands.update(middle + GLANCE * direction)
            ahead = self._tasks(asked, instant.held)
            then = least_motions(ahead.rows, self._shares, ahead.rates, made).mobility
            kept = kept_share(motions.asked, motions.mobility, then, self._robot.max_acceleration)
            kept = 0.0 if motions.lost > LOST else kept
            if kept < SLOWED:
                curved = (ahead.rows - tasks.rows) @ direction / GLANCE
                ended = self._ended(
                    asked, Conditioning(tasks.rates, direction, curved, motions.mobility, motions.lost)
                )
            share = min(share, kept)
        before = motions.made if self._motion is None else self._motion
        most, max_jerk = RAMP_SHARE * limits.max_ddq, instant.max_jerk
        rates, motion = ramped(motions, before, tasks.rates, made, share, most, max_jerk, cycle_s)
        rates, near = self._way(rates), self._near(instant, box)
        drift = programme.Drift(cycle_s * self._drift(q, made), self._weights)

        def solved(rates: Array) -> programme.Solution | None:
            wanted = programme.Wanted(tasks.rows, rates, made, back, cycle_s)
            return programme.solve(wanted, box, drift, near.barriers)

        found = solved(rates)
        if found is not None and found.off_line > OFF_LINE_M:
            # the joints cannot take the turn: a brake along the line that the tasks are on is always within bounds
            remains = (cycles - 1) / cycles
            straight = self._way(remains * made)
            braked = solved(straight)
            if braked is not None and braked.off_line < found.off_line:
                found, rates, motion = braked, straight, remains * motions.made
        if found is None:
            line.forget()
            self._going = self._motion = None
            return Advance(dq_last * ((cycles - 1) / cycles))
        self._going = found.pace * rates
        self._motion = found.pace * motion
        line.go((cycle_s * self._going[: len(error)] / self._units).reshape(-1, 6), instant.held)
        if not asked or ended is not None or found.pace >= SLOWED:
            return Advance(found.dq, ended)
        return Advance(found.dq, binding(self._robot, instant, found, box, near))

    def _together(self, tasks: DrivenTasks, held: HeldObject | None) -> DrivenTasks:
        """The same tasks, the hands' rates projected on common motion of the held object."""
        if held is None:
            return tasks
        rates, hands = tasks.rates.copy(), len(self._units)
        rates[:hands] = held.together(self._hands.positions, rates[:hands])
        return DrivenTasks(tasks.rows, rates)

    def _way(self, rates: Array) -> Array:
        """(r,) rates of the tasks in this cycle, of those that the ramp leads to."""
        return rates

    def _near(self, instant: Instant, box: Box) -> Near:
        if instant.surroundings is None:
            return self._nothing_near
        return instant.surroundings.near(instant.q_cmd, box.slowest, box.fastest)
