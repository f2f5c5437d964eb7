"""The modes whose tasks are the hands: decoupled, self-motion and coupled."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.criteria.formulas import Postures, RobotData
from deltaq_controllers.criteria.table import Normalised
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.modes.hands import Hands, HeldObject, allowed_while_braked
from deltaq_controllers.modes.interface import Advance, Conditioning, Instant, Limit, Limitation, Motion
from deltaq_controllers.modes.programme import Box
from deltaq_controllers.modes.resolved import DrivenTasks, ResolvedMode
from deltaq_controllers.surroundings.surroundings import Near
from deltaq_controllers.task import NO_TASK, Task, tolerant
from deltaq_protocol.arrays import Array, Indices
from deltaq_protocol.driving import DrivingMode

# Coupled Cartesian mode: hand motion in, all joints out.


# Joint travel: how far the joints are from the middle of their ranges (Hooper & Noakes, Table 2, constraint).


def travel(q: Array, lower: Array, upper: Array) -> float:
    """0 with all joints in the middle of their ranges, 1 at the ends: `sum(((q - middle) / half)^2) / n`."""
    return float(np.mean(((2.0 * q - lower - upper) / (upper - lower)) ** 2))


@compiled
def travel_gradient(q: Array, lower: Array, upper: Array) -> Array:
    """(n,) gradient of `travel` [1/rad or 1/m]."""
    gradient = np.empty_like(q)
    for joint in range(len(q)):
        width = upper[joint] - lower[joint]
        gradient[joint] = 4.0 * (2.0 * q[joint] - lower[joint] - upper[joint]) / width**2 / len(q)
    return gradient


DRIFT_SHARE_S_M = 2.5
"""Fraction of its greatest speed that the criteria may ask of a joint, per m/s of the fastest hand [s/m]."""

FULL_DESCENT_S = 0.005
"""Weighted descent of the criteria, over a joint's greatest speed, above which it is clipped [s]."""


TOLERANCE_SHARE = 0.01
"""Share of a tolerance in the work, where a joint has one: commands move the hand itself, except next to a
singularity."""

REGION_S = 0.5
"""Least time in which a hand may use up its distance to the border of its region [s]."""

_DAMPING = 1e-9
"""Added to the squares of a Jacobian, so that a singular one gives no infinite rates [m^2]."""

_NOTHING = 1e-24
"""Square of an increment that counts as none [rad^2 or m^2]."""


@dataclass(frozen=True)
class WeightedCriterion:
    """A cost that the redundant joints reduce.

    Attributes:
        gradient: (n,) gradient at a configuration (n,).
        weight: its weight among the criteria.
    """

    gradient: Callable[[Array], Array]
    weight: float = 1.0


def weighed(data: RobotData, weights: Mapping[str, float]) -> WeightedCriterion:
    """A weighted sum of the criteria of `deltaq_controllers.criteria.table`, by name.

    Raises:
        CriterionError: an unknown criterion, or a weight that is negative or not finite.
    """
    cost = Normalised(data, weights)

    def gradient(q: Array) -> Array:
        row: Array = cost.gradient(Postures(data, q[None]))[0]
        return row

    return WeightedCriterion(gradient)


class CoupledMode(ResolvedMode):
    """Shared control (Hooper & Noakes, section IV): redundancy resolved by weighted criteria.

    The tasks are the hands. The joints drift down the criteria in their null space (Liegeois), only while the operator
    moves a hand: no input, no motion.

    Tolerances of a task are joints, too. A command moves the hand along every axis; only the drift uses tolerances,
    from where the hand was when the mode began.

    Args:
        robot: the robot.
        criteria: for redundant joints; by default they stay near the middle of their ranges.
        task: names tolerances and regions of the hands, and the time for which they have to be still.

    Raises:
        TaskError: the robot does not have a hand that the task names.
    """

    name = DrivingMode.COUPLED
    drives_hands = True

    def __init__(
        self,
        robot: RobotModel,
        criteria: Sequence[WeightedCriterion] | None = None,
        task: Task = NO_TASK,
    ) -> None:
        super().__init__(tolerant(robot, task))
        self._n, self._task, self._own = robot.n, task, Hands(robot)
        self._regions = [task.region(hand) for hand in robot.hands]
        self._shares[self._n :] *= TOLERANCE_SHARE
        self._weights = 1.0 / self._shares
        self._off = self._off_last = np.zeros(self._robot.n - robot.n)
        self._held: HeldObject | None = None
        self._still_s = 0.0
        self._max_velocity = robot.max_velocity
        self.drives_joints = np.zeros(robot.n, dtype=np.bool_)
        self._criteria = (
            (WeightedCriterion(lambda q: travel_gradient(q, robot.lower, robot.upper)),)
            if criteria is None
            else tuple(criteria)
        )

    @property
    def status(self) -> str:
        """For how long the hands have been still, if the task has them dwell."""
        dwell_s = self._task.dwell_s
        return f"still for {min(self._still_s, dwell_s):.1f} of {dwell_s:g} s" if dwell_s else ""

    def enter(self, q: Array) -> None:
        """The tolerances begin at the present poses of the hands."""
        self._off = self._off_last = np.zeros_like(self._off)
        self._held, self._still_s = None, 0.0
        super().enter(np.append(q, self._off))

    def advance(self, instant: Instant, asked: Motion) -> Advance:
        """The increment that continues towards the requested motion, as far as the regions allow."""
        q, dq_last = instant.q_cmd, instant.dq_last
        inside, edge = self._inside(q, asked)
        is_still = not asked and not dq_last.any()
        self._still_s = self._still_s + instant.cycle_s if is_still else 0.0
        if instant.held is not self._held:
            self._held, self._off, self._off_last = instant.held, 0.0 * self._off, 0.0 * self._off
            self._line.forget()
        # the gate may have admitted a part only
        last = self._asked[: self._n]
        share = float(np.clip(last @ dq_last / max(float(last @ last), _NOTHING), 0.0, 1.0))
        off, before = share * self._asked[self._n :], self._off_last
        self._off, self._off_last = self._off + off, off
        whole = replace(
            instant,
            q_cmd=np.append(q, self._off),
            dq_last=np.append(dq_last, off),
            dq_before=np.append(instant.dq_before, before),
            limits=self._limits(instant),
            max_jerk=np.append(instant.max_jerk, np.full(len(off), np.inf)),
        )
        found = super().advance(whole, inside)
        return Advance(found.dq[: self._n], found.limitation or (edge if asked else None))

    def _limits(self, instant: Instant) -> IncrementLimits:
        if not len(self._off):
            return instant.limits
        own = IncrementLimits.of(self._robot, instant.cycle_s)
        if instant.held is not None:
            # hands that hold an object do not slip on it
            own = own._replace(lower=0.0 * own.lower, upper=0.0 * own.upper)
        return IncrementLimits(
            *(np.append(a, b[self._n :]) for a, b in zip(instant.limits, own, strict=True))
        )

    def _inside(self, q: Array, asked: Motion) -> tuple[Motion, Limitation | None]:
        """The motion, slowed before the border of a hand's region, and the region that slows it."""
        if not any(self._regions):
            return asked, None
        self._own.place(q)
        twists, edge = asked.hands.copy(), None
        for hand, (region, twist) in enumerate(zip(self._regions, twists, strict=True)):
            if region is None:
                continue
            place = self._own.positions[hand]
            lower, upper = (np.subtract(side, place) for side in (region.lower_m, region.upper_m))
            room = np.where(twist[:3] > 0.0, np.maximum(upper, 0.0), np.maximum(-lower, 0.0))
            moves = twist[:3] != 0.0
            share = np.min(room[moves] / (REGION_S * np.abs(twist[:3][moves])), initial=1.0)
            if share < 1.0:
                name = self._own.names[hand]
                text = f"the {name} is at the border of the task's region"
                edge = Limitation(Limit.WORKSPACE_EDGE, name, text)
            twist *= share
        return replace(asked, hands=twists), edge

    def _near(self, instant: Instant, box: Box) -> Near:
        if instant.surroundings is None:
            return self._nothing_near
        own = slice(0, self._n)
        near = instant.surroundings.near(instant.q_cmd[own], box.slowest[own], box.fastest[own])
        rows = np.pad(near.barriers.rows, ((0, 0), (0, len(self._off))))
        return near._replace(barriers=near.barriers._replace(rows=rows))

    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        del held
        return DrivenTasks(self._units[:, None] * self._hands.jacobian, self._units * motion.hands.ravel())

    def _drift(self, q: Array, made: Array) -> Array:
        """(n,) rates that lower the criteria, and those of the tolerances that go with them."""
        q, shares = q[: self._n], self._shares[: self._n]
        descent = np.zeros_like(q)
        for criterion in self._criteria:
            descent -= criterion.weight * criterion.gradient(q)
        rates = _shared_out(descent, shares, self._max_velocity, made)
        if not len(self._off):
            return rates
        rows = self._units[:, None] * self._hands.jacobian
        driven, free = rows[:, : self._n], rows[:, self._n :]
        # what the tasks leave of the descent once the tolerances are free: they do not resist it, only commands
        kept = np.linalg.qr(free, mode="complete")[0][:, len(self._off) :].T @ driven
        square = (kept * shares) @ kept.T + _DAMPING * np.eye(len(kept))
        rates -= shares * (kept.T @ np.linalg.solve(square, kept @ rates))
        return np.append(rates, -np.linalg.lstsq(free, driven @ rates, rcond=None)[0])


@compiled
def _shared_out(descent: Array, shares: Array, max_velocity: Array, made: Array) -> Array:
    """(n,) joint rates of a descent, in proportion to the speed of the fastest hand; they go at `made` (r,)."""
    # shared out as the tasks are: only then does what the tasks leave of the descent still descend
    rates = shares * descent
    fastest, square = FULL_DESCENT_S, 0.0
    for joint in range(len(rates)):
        fastest = max(fastest, abs(rates[joint]) / max_velocity[joint])
    for first in range(0, len(made), 3):
        square = max(square, made[first] ** 2 + made[first + 1] ** 2 + made[first + 2] ** 2)
    return rates * (DRIFT_SHARE_S_M * math.sqrt(square) / fastest)


# Decoupled Cartesian mode: base joints one by one, the six joints next to each hand by the hand's motion.


class DecoupledMode(ResolvedMode):
    """The classic mode of teleoperation (Hooper & Noakes, section II).

    The tasks are the hands, carried along by the base joints, and the base joints. An object that the hands hold is
    carried along by base joints that carry all of them; under the others it stays where it is.
    """

    name = DrivingMode.DECOUPLED
    drives_hands = True

    def __init__(self, robot: RobotModel) -> None:
        super().__init__(robot)
        self.drives_joints = np.logical_not(self._hands.arms.any(axis=0))
        self._driven = np.flatnonzero(self.drives_joints)
        self._carries_all = self.drives_joints & self._hands.moved_by.all(axis=0)

    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        carries = self.drives_joints if held is None else self._carries_all
        rows, rates = _carried(
            self._units, self._hands.jacobian, motion.hands, motion.joints, self._driven, carries
        )
        return DrivenTasks(rows, rates)


@compiled
def _carried(
    units: Array, jacobian: Array, twists: Array, joints: Array, driven: Indices, carries: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Rows and rates of the hands' twists (h, 6), which the joints that carry add to, and of the driven joints (m,)."""
    tasks, n = jacobian.shape
    rows, rates = np.zeros((tasks + len(driven), n)), np.empty(tasks + len(driven))
    for row in range(tasks):
        rates[row] = units[row] * twists[row // 6, row % 6]
        for joint in range(n):
            rows[row, joint] = units[row] * jacobian[row, joint]
            if carries[joint]:
                rates[row] += rows[row, joint] * joints[joint]
    for place in range(len(driven)):
        rows[tasks + place, driven[place]] = 1.0
        rates[tasks + place] = joints[driven[place]]
    return rows, rates


# Self-motion mode: any joint driven, all others move so that the hands stay.


class SelfMotionMode(ResolvedMode):
    """Moves within the null space of the hands (Hooper & Noakes, section II).

    The tasks are the hands, held where they were when the mode began, and the joints that are driven. A brake of the
    gate, which is straight in joint space, may move the hands a little, and the next motion corrects that. A joint that
    cannot move without the hands does not move.

    Raises:
        ControllerError: the robot is not redundant.
    """

    name = DrivingMode.SELF_MOTION
    drives_hands = False

    def __init__(self, robot: RobotModel) -> None:
        hands = len(robot.hands)
        if robot.n <= 6 * hands:
            raise ControllerError(
                f"self-motion needs more than {6 * hands} joints for {hands} hand{'s' * (hands > 1)}, robot "
                f"{robot.name!r} has {robot.n}; choose joint, decoupled or coupled"
            )
        super().__init__(robot)
        self.drives_joints = np.ones(robot.n, dtype=np.bool_)
        self._joints = np.eye(robot.n)
        self._driven = np.zeros(robot.n, dtype=np.bool_)

    def enter(self, q: Array) -> None:
        """Keep the hands at their present poses."""
        super().enter(q)
        self._hands.update(q)
        self._line.begin(self._hands)

    def _rest(self) -> None:
        """The hands stay where they were when the mode began."""

    def _intervened(self) -> None:
        """The hands keep their poses from the start of the mode, also after scaled increments."""

    def _allowed(self, instant: Instant, motion: Motion) -> float:
        rates = instant.dq_last / instant.cycle_s
        going = float(np.abs(rates[motion.joints != 0.0]).max(initial=0.0))
        allowed = going * allowed_while_braked(
            self._hands, instant.q_cmd, rates, self._robot.max_acceleration
        )
        asked = float(np.abs(motion.joints).max())
        return min(1.0, allowed / asked) if going > 0.0 and asked > 0.0 else 1.0

    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        del held  # it stays as the hands do
        driven = motion.joints != 0.0
        if (driven != self._driven).any():
            # other tasks than before: how they go is read off the joints
            self._driven, self._going = driven, None
        hands = self._units[:, None] * self._hands.jacobian
        rates = np.concatenate([np.zeros(len(hands)), motion.joints[driven]])
        return DrivenTasks(np.vstack([hands, self._joints[driven]]), rates)

    def _way(self, rates: Array) -> Array:
        rates[: len(self._units)] = 0.0
        return rates

    def _ended(self, motion: Motion, conditioning: Conditioning) -> Limitation:
        del conditioning
        names = ", ".join(np.array(self._robot.joint_names)[motion.joints != 0.0])
        return Limitation(Limit.SINGULARITY, names, f"{names} cannot move here without moving the hand")
