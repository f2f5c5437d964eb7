"""Programs as operators: they see the robot with a delay, and steer it to one goal after the other in their mode."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np
import pinocchio as pin

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.hand_modes import travel_gradient
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import HAND_AXES, DrivingMode, OperatorCommand

REACTION_S, REACTION_SPREAD = 0.25, 0.1
NOISE, NOISE_MEMORY_S = 0.1, 0.15
SLIP, ACTION_S = 0.02, 0.6


class Slip(StrEnum):
    """A slip of an operator's hand."""

    AXIS = "wrong axis"
    WAY = "wrong way"
    LATE = "let go too late"
    KEY = "wrong option"


@dataclass(frozen=True)
class Person:
    """One operator: slow to react, noisy, and now and then on the wrong axis or key.

    Assumptions and their sources:

    - Reaction: 0.25 s, differing by a tenth from one operator to the next (simple visual reactions take 0.2 to 0.3 s:
      Woods et al., Front. Hum. Neurosci. 9:131, 2015; the spread is an assumption).
    - Noise: a rate deviates by a tenth of the whole command, in all axes of it, with a memory of 0.15 s. That noise
      grows with the signal is Harris and Wolpert's (Nature 394:780, 1998), a tenth the order of what van Beers, Haggard
      and Wolpert find for reaching (J. Neurophysiol. 91:1050, 2004); that it holds for a hand controller, and its
      memory, are assumptions.
    - Slips: one action in fifty goes wrong, HEART's figure for a routine, highly practised, rapid task (Williams 1986).
      Which of the kinds in `Slip` it is, all equally likely, is an assumption, and so is that a continuous motion
      consists of an action every 0.6 s. A slip is noticed, and ends, one reaction later.

    Attributes:
        reaction_s: reaction time.
        noise: standard deviation of a rate, over the size of the command.
        slip: probability that an action goes wrong.
    """

    reaction_s: float = REACTION_S
    noise: float = NOISE
    slip: float = SLIP

    @classmethod
    def drawn(cls, generator: np.random.Generator) -> Person:
        """An operator among many."""
        spread = float(np.clip(generator.normal(0.0, REACTION_SPREAD), -0.3, 0.3))
        return cls(reaction_s=REACTION_S * (1.0 + spread))


class OperatorHand:
    """The errors of an operator's hand: noise and slips.

    Args:
        person: whose hand it is.
        cycle_s: sample time [s].
        generator: of random numbers.

    Attributes:
        slips: how many there were of each kind.
    """

    def __init__(self, person: Person, cycle_s: float, generator: np.random.Generator) -> None:
        self._person, self._cycle_s, self._generator = person, cycle_s, generator
        self._noise: dict[str, float] = {}
        self._meant: OperatorCommand = OperatorCommand()
        self._since_action_s = np.inf
        self._slip: OperatorCommand | None = None
        self._slip_left_s = 0.0
        self.slips: Counter[Slip] = Counter()

    def done(self, meant: OperatorCommand, axes: Mapping[str, float], options: int) -> OperatorCommand:
        """The given command for an intended one.

        Args:
            meant: the intended command of this cycle.
            axes: axes that may be confused, each with its greatest rate [m/s or rad/s].
            options: number of options that may be confused.
        """
        self._begin(meant, axes, options)
        self._meant = meant
        if self._slip is not None:
            self._slip_left_s -= self._cycle_s
            given, self._slip = self._slip, self._slip if self._slip_left_s > 0.0 else None
            return self._noisy(replace(given, mode=meant.mode))
        return self._noisy(meant)

    def _begin(self, meant: OperatorCommand, axes: Mapping[str, float], options: int) -> None:
        """Whether an action begins here, and goes wrong."""
        self._since_action_s += self._cycle_s
        moved, moves = _driven(self._meant), _driven(meant)
        is_new = moves != moved or meant.option != self._meant.option
        if self._slip is not None or not (is_new or (moves and self._since_action_s >= ACTION_S)):
            return
        self._since_action_s = 0.0
        if self._generator.random() >= self._person.slip:
            return
        kinds = []
        if moves:
            kinds = [Slip.AXIS, Slip.WAY] if len(axes) > 1 else [Slip.WAY]
        elif moved:
            kinds = [Slip.LATE]
        elif meant.option is not None and options > 1:
            kinds = [Slip.KEY]
        if kinds:
            kind = kinds[int(self._generator.integers(len(kinds)))]
            self.slips[kind] += 1
            self._slip, self._slip_left_s = (
                self._gone_wrong(kind, meant, axes, options),
                self._person.reaction_s,
            )

    def _gone_wrong(
        self, kind: Slip, meant: OperatorCommand, axes: Mapping[str, float], options: int
    ) -> OperatorCommand:
        if kind is Slip.LATE:
            return replace(meant, rates=self._meant.rates)
        if kind is Slip.WAY:
            return replace(meant, rates={axis: -rate for axis, rate in meant.rates.items()})
        if kind is Slip.KEY:
            others = [option for option in range(1, options + 1) if option != meant.option]
            return replace(meant, option=int(self._generator.choice(others)))
        rates = dict(meant.rates)
        taken = max(rates, key=lambda axis: abs(rates[axis]))
        other = str(self._generator.choice([axis for axis in axes if axis != taken]))
        # the stick is deflected as far as intended, on either axis
        share = axes[other] / axes[taken]
        rates[taken], rates[other] = rates.get(other, 0.0) / share, rates[taken] * share
        return replace(meant, rates=rates)

    def _noisy(self, command: OperatorCommand) -> OperatorCommand:
        """The command with noise in proportion to its size, in every axis of its kind."""
        kept = float(np.exp(-self._cycle_s / NOISE_MEMORY_S))
        rates = dict(command.rates)
        for axes in _kinds(rates):
            size = float(np.linalg.norm([rates[axis] for axis in axes]))
            for axis in axes:
                fresh = self._generator.normal(0.0, self._person.noise * np.sqrt(1.0 - kept * kept))
                self._noise[axis] = kept * self._noise.get(axis, 0.0) + fresh
                rates[axis] += size * self._noise[axis]
        return replace(command, rates=rates)


def _driven(command: OperatorCommand) -> frozenset[str]:
    """The axes that a command moves."""
    return frozenset(axis for axis, rate in command.rates.items() if rate != 0.0)


def _kinds(rates: dict[str, float]) -> list[list[str]]:
    """Axes whose rates have one unit and one stick: those along, those about, and each joint by itself."""
    along, about = [
        [axis for axis in rates if axis in group] for group in (("x", "y", "z"), ("rx", "ry", "rz"))
    ]
    return [
        axes for axes in (along, about, *([axis] for axis in rates if axis not in (*along, *about))) if axes
    ]


HAND_M_S, HAND_RAD_S = 0.1, np.deg2rad(20.0)
JOINT_M_S, JOINT_RAD_S = 0.1, np.deg2rad(10.0)
"""Greatest rates that an operator asks for."""

GAIN_S = 1.5
"""Rate for an error, before the greatest is reached [1/s]; 250 ms of delay bear no more than about 2."""

CHANGE_S = 0.4
"""Time to choose another joint."""

NEAR_M, NEAR_RAD = 1.5e-3, np.deg2rad(0.3)
"""Tolerance within which an operator takes a goal for reached."""


_WEAK = 0.02
"""Singular values below this part of the greatest are taken for zero."""


@dataclass(frozen=True)
class HandGoal:
    """A goal for the hand.

    Attributes:
        name: of the part of the task that ends there.
        pose: T_world_tool, (4, 4).
        steps: into how many pieces an operator without hand axes divides the path.
    """

    name: str
    pose: Array
    steps: int = 1


def error_to(goal: Array, pose: Array) -> Array:
    """(6,) offset [m] over rotation vector [rad] from a pose to a goal, both (4, 4), world axes."""
    turn: Array = pin.log3(goal[:3, :3] @ pose[:3, :3].T)
    return np.concatenate([goal[:3, 3] - pose[:3, 3], turn])


def is_near(error: Array) -> bool:
    """Whether an operator takes the goal for reached."""
    return bool(np.linalg.norm(error[:3]) < NEAR_M and np.linalg.norm(error[3:]) < NEAR_RAD)


class Late:
    """The operator's delayed view: configurations one reaction time ago."""

    def __init__(self, cycle_s: float, reaction_s: float) -> None:
        self._seen: deque[Array] = deque(maxlen=max(1, round(reaction_s / cycle_s)))

    def __call__(self, q: Array) -> Array:
        """The configuration (n,) that the operator sees while the robot is at `q` (n,)."""
        self._seen.append(q)
        return self._seen[0]

    @property
    def stands(self) -> bool:
        """Whether the robot has not moved in all that is seen."""
        first = self._seen[0]
        return len(self._seen) == self._seen.maxlen and bool(np.abs(self._seen[-1] - first).max() < 2e-5)


class ScriptedOperator(Protocol):
    """Steers to one goal."""

    def command(self, q: Array, goal: HandGoal) -> OperatorCommand | None:
        """The command on seeing the robot at `q` (n,) now; None when the goal has been reached."""
        ...


class HandOperator:
    """Steers the hand by its axes, as in decoupled and coupled mode."""

    def __init__(self, robot: RobotModel, cycle_s: float, reaction_s: float, mode: DrivingMode) -> None:
        self._robot, self._mode = robot, mode
        self._see = Late(cycle_s, reaction_s)

    @property
    def stands(self) -> bool:
        """Whether the robot has not moved in all that is seen."""
        return self._see.stands

    def command(self, q: Array, goal: HandGoal) -> OperatorCommand | None:
        """Rates in proportion to the error, up to the greatest."""
        error = error_to(goal.pose, self._robot.forward(self._see(q)))
        if is_near(error) and self._see.stands:
            return None
        rates = GAIN_S * error
        excess = max(np.linalg.norm(rates[:3]) / HAND_M_S, np.linalg.norm(rates[3:]) / HAND_RAD_S, 1.0)
        if is_near(error):
            rates[:] = 0.0
        return OperatorCommand(dict(zip(HAND_AXES, (rates / excess).tolist(), strict=True)), self._mode)


class PostureOperator:
    """Steers the hand as in decoupled mode, and improves the posture by self-motion before each piece of work.

    The base joint that lowers joint travel the most is driven for `POSTURE_S`, once for each goal that is reached from
    afar.
    """

    POSTURE_S = 3.0

    def __init__(self, robot: RobotModel, cycle_s: float, reaction_s: float) -> None:
        self._robot, self._cycle_s = robot, cycle_s
        self._hand = HandOperator(robot, cycle_s, reaction_s, DrivingMode.DECOUPLED)
        self._base = np.flatnonzero(~Hands(robot).arms.any(axis=0))
        self._left: int | None = None
        self._command = OperatorCommand()

    def command(self, q: Array, goal: HandGoal) -> OperatorCommand | None:
        """To the goal, then the posture."""
        if self._left is None:
            command = self._hand.command(q, goal)
            if command is not None or not goal.name.startswith("reach"):
                return command
            self._left = round(self.POSTURE_S / self._cycle_s)
            self._command = self._better(q)
        if self._left > 0:
            self._left -= 1
            return self._command
        self._left = None
        return None

    def _better(self, q: Array) -> OperatorCommand:
        descent = -travel_gradient(q, self._robot.lower, self._robot.upper)
        gains = []
        for joint in self._base:
            jacobian = self._robot.jacobian(q)
            others = np.where(np.arange(self._robot.n) == joint, 0.0, jacobian)
            way = -np.linalg.pinv(others, rcond=_WEAK) @ jacobian[:, joint]
            way[joint] = 1.0
            gains.append(float(descent @ way))
        best = int(np.argmax(np.abs(gains)))
        name = self._robot.joint_names[self._base[best]]
        return OperatorCommand({name: float(np.sign(gains[best])) * 0.05}, DrivingMode.SELF_MOTION)


class AdvisedOperator:
    """Steers the hand as in decoupled mode, and goes to an option of the advisor before each piece of work.

    The option is the reachable one with the largest margin to the nearest joint limit. The operator goes to an option
    once for each distant goal, and whenever a limit stops the hand; if the hand is stopped again on the way to the same
    goal, the operator goes to the next option. The advisor's search takes no time here.
    """

    def __init__(self, teleoperator: Teleoperator, cycle_s: float, reaction_s: float) -> None:
        self._teleoperator = teleoperator
        self._hand = HandOperator(teleoperator.robot, cycle_s, reaction_s, DrivingMode.DECOUPLED)
        self._is_advised = self._is_stuck = False
        self._goal: HandGoal | None = None
        self._times_stuck = 0

    def command(self, q: Array, goal: HandGoal) -> OperatorCommand | None:
        """To the goal, then the option; where something stops the hand, the option first."""
        if goal is not self._goal:
            self._goal, self._times_stuck = goal, 0
        if not self._is_advised:
            command = self._hand.command(q, goal)
            self._is_stuck = (
                command is not None and self._hand.stands and self._teleoperator.limitation is not None
            )
            if not self._is_stuck and (command is not None or not goal.name.startswith("reach")):
                return command
            self._is_advised = True
        if self._teleoperator.mode is not DrivingMode.ADVISOR:
            return OperatorCommand(mode=DrivingMode.ADVISOR)
        option = self._best()
        if option is not None and self._teleoperator.arrived_at != option:
            return OperatorCommand(option=option)
        self._is_advised = False
        self._times_stuck += self._is_stuck
        return self._hand.command(q, goal) if self._is_stuck else None

    def _best(self) -> int | None:
        mode = self._teleoperator.mode_named(DrivingMode.ADVISOR)
        assert isinstance(mode, AdvisorMode)
        ways = {
            rank: one.limit_share for rank, one in enumerate(mode.options, start=1) if one.path is not None
        }
        ranks = sorted(ways, key=lambda rank: -ways[rank])
        return ranks[self._times_stuck % len(ranks)] if ranks else None


class JointOperator:
    """Drives one joint after the other to its goal position, the one farthest away first.

    The operator knows that, as with a robot whose points have been taught: a generous assumption.
    """

    def __init__(self, robot: RobotModel, cycle_s: float, reaction_s: float) -> None:
        self._robot, self._cycle_s = robot, cycle_s
        self._arm = Hands(robot).arms.any(axis=0)
        self._see = Late(cycle_s, reaction_s)
        self._rates = np.where(robot.revolute, JOINT_RAD_S, JOINT_M_S)
        self._near = np.full(robot.n, 2e-4)
        self._goal: HandGoal | None = None
        self._ways: list[Array] = []
        self._joint: int | None = None
        self._pause = 0

    def command(self, q: Array, goal: HandGoal) -> OperatorCommand | None:
        """The rate of the joint that is driven now."""
        if goal is not self._goal:
            self._goal, self._ways = goal, self._divided(q, goal)
        seen = self._see(q)
        if self._pause > 0:
            self._pause -= 1
            return OperatorCommand({}, DrivingMode.JOINT)
        off = self._ways[0] - seen
        if self._joint is not None and abs(off[self._joint]) > self._near[self._joint]:
            return self._driving(self._joint, off)
        if not self._see.stands:
            return OperatorCommand({}, DrivingMode.JOINT)
        worst = int(np.argmax(np.abs(off) / self._rates))
        if abs(off[worst]) > self._near[worst]:
            self._joint, self._pause = worst, round(CHANGE_S / self._cycle_s)
            return OperatorCommand({}, DrivingMode.JOINT)
        self._joint = None
        self._ways.pop(0)
        return OperatorCommand({}, DrivingMode.JOINT) if self._ways else None

    def _driving(self, joint: int, off: Array) -> OperatorCommand:
        rate = float(np.clip(GAIN_S * off[joint], -self._rates[joint], self._rates[joint]))
        return OperatorCommand({self._robot.joint_names[joint]: rate}, DrivingMode.JOINT)

    def _divided(self, q: Array, goal: HandGoal) -> list[Array]:
        """Configurations along the straight way to a goal."""
        start = self._robot.forward(q)
        error = error_to(goal.pose, start)
        ways = []
        for step in range(1, goal.steps + 1):
            share = step / goal.steps
            pose = start.copy()
            pose[:3, 3] += share * error[:3]
            pose[:3, :3] = pin.exp3(share * error[3:]) @ start[:3, :3]
            q = self._inverse(q, pose)
            ways.append(q)
        return ways

    def _inverse(self, q: Array, pose: Array) -> Array:
        for _ in range(30):
            error = error_to(pose, self._robot.forward(q))
            q = q + np.linalg.pinv(self._robot.jacobian(q) * self._arm, rcond=_WEAK) @ error
        return q
