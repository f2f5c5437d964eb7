"""The teleoperator: a controller whose mode can be switched while the robot moves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError, LastIncrement, View
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.modes.hand_modes import CoupledMode, DecoupledMode, SelfMotionMode
from deltaq_controllers.modes.hands import Hands, HeldObject
from deltaq_controllers.modes.interface import (
    Instant,
    Limitation,
    Motion,
    TeleoperationMode,
    from_verdict,
    of_object,
)
from deltaq_controllers.modes.stepped import JointMode
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import HAND_AXES, DrivingMode, Frame, Grip, OperatorCommand
from deltaq_protocol.messages import Outcome, Verdict

# The executed fraction of an operator's command, for display and force feedback. Pure.


SMOOTHED_S = 0.1
"""Time constant with which the share follows: a single cycle is not felt [s]."""


def share_of(asked: Motion, rates: Array, hands: Hands) -> float:
    """The share of a motion's rates that joints at rates (n,) make along it, 0 to 1; 1 for no motion.

    Args:
        asked: the motion.
        rates: (n,) of the joints [rad/s or m/s].
        hands: of the robot, placed at its configuration.
    """
    if asked.along:
        return float(rates.any())
    return _share(asked.joints, asked.hands, rates, hands.units, hands.jacobian)


@compiled
def _share(joints: Array, twists: Array, rates: Array, units: Array, jacobian: Array) -> float:
    """`share_of` for rates of joints (n,) and twists of hands (h, 6)."""
    square, along = 0.0, 0.0
    for joint in range(len(joints)):
        square += joints[joint] ** 2
        along += joints[joint] * rates[joint]
    for row in range(len(units)):
        wanted = units[row] * twists[row // 6, row % 6]
        if wanted != 0.0:
            made = 0.0
            for joint in range(len(rates)):
                made += jacobian[row, joint] * rates[joint]
            square += wanted**2
            along += wanted * units[row] * made
    return min(1.0, max(0.0, along / square)) if square > 0.0 else 1.0


class Reflection:
    """The executed fraction of the command, while something limits the operator.

    Args:
        cycle_s: the robot's cycle [s].

    Attributes:
        share: from 0, nothing, to 1, all of it or nothing that limits.
    """

    def __init__(self, cycle_s: float) -> None:
        self._follows = 1.0 - math.exp(-cycle_s / SMOOTHED_S)
        self._admitted = 1.0
        self.share = 1.0

    def take(self, share: float, is_asked: bool, is_limited: bool) -> None:
        """Take one cycle: the fraction of the commanded motion that was requested of the gate.

        Acceleration is not a limit: the fraction counts while a limit binds, in the mode or at the gate.
        """
        is_reflected = is_asked and (is_limited or self._admitted < 1.0)
        now = share * self._admitted if is_reflected else 1.0
        self.share += self._follows * (now - self.share)

    def take_verdict(self, verdict: Verdict) -> None:
        """Take the gate's verdict on the increment of this cycle."""
        is_whole = verdict.outcome is Outcome.ADMITTED
        self._admitted = 1.0 if is_whole else max(0.0, min(1.0, verdict.scale))


# What an operator commands, as a motion of the joints and hands that a mode drives.


def commanded(
    command: OperatorCommand,
    robot: RobotModel,
    hands: Hands,
    mode: TeleoperationMode,
    frame: Frame,
    held: HeldObject | None,
    q: Array,
) -> Motion:
    """The motion that a command asks of a mode of joints or of hands.

    Args:
        command: of the operator.
        robot: the driven robot.
        hands: its hands; they are placed at `q`.
        mode: the mode that drives it.
        frame: the axes in which hands are moved.
        held: the object between the hands, which then moves in their place.
        q: (n,) configuration [rad or m].
    """
    motion, joints = Motion.rest(robot.n, len(hands.names)), robot.joint_names
    for axis, rate in command.rates.items():
        hand, _, plain = axis.rpartition(".")
        if axis in joints:
            motion.joints[joints.index(axis)] = rate
        elif plain in HAND_AXES and (not hand or hand in hands.names):
            rows = hands.names.index(hand) if hand else slice(None)
            motion.hands[rows, HAND_AXES.index(plain)] = rate
    motion.joints[~mode.drives_joints] = 0.0
    if not mode.drives_hands:
        motion.hands[:] = 0.0
        return motion
    hands.update(q)
    if held is not None:
        axes = held.axes(hands.rotations) if frame is Frame.TOOL else np.eye(3)
        motion.hands[:] = held.hands_twists(hands.positions, _turned(axes, motion.hands[0]))
    elif frame is Frame.TOOL:
        for hand_twist, axes in zip(motion.hands, hands.rotations, strict=True):
            hand_twist[:] = _turned(axes, hand_twist)
    return motion


def _turned(axes: Array, twist: Array) -> Array:
    """A twist (6,) in axes (3, 3), in those of the world."""
    return np.concatenate([axes @ twist[:3], axes @ twist[3:]])


ModeTable = Mapping[DrivingMode, Callable[[RobotModel], TeleoperationMode]]

MODES: ModeTable = {
    DrivingMode.JOINT: JointMode,
    DrivingMode.DECOUPLED: DecoupledMode,
    DrivingMode.SELF_MOTION: SelfMotionMode,
    DrivingMode.COUPLED: CoupledMode,
}
"""The modes that need no more than the robot; `advisor` needs to know the cell."""


class Teleoperator:
    """Drives a robot as its operator commands.

    Set `command` and ask for the increment, once a cycle; an empty command brings the robot to rest. Another mode
    takes over when the robot has come to rest in the one before, a fraction of a second after it was commanded; so does
    another grip.

    Args:
        robot: the robot.
        cycle_s: its cycle [s].
        mode: the mode to begin with.
        frame: the axes in which hands are moved.
        modes: makers of the modes.
        surroundings: bodies that the robot keeps clear of by itself; without them that is left to the gate.
        jerk_time_s: time in which a joint's acceleration builds up to its limit; 0 sets no limit to the jerk [s].

    Attributes:
        robot, cycle_s, surroundings, jerk_time_s: as given.
        command: the operator's present command.
        frame: the axes in which hands are moved.
        grip: whether hands move by themselves, or hold one object together.
        held: the object that they hold.
        limitation: the limiting factor of this cycle; None without one.
        reflection: the executed fraction of the commanded motion.

    Raises:
        ControllerError: the robot cannot be driven in that mode.
    """

    def __init__(
        self,
        robot: RobotModel,
        cycle_s: float,
        mode: DrivingMode = DrivingMode.JOINT,
        frame: Frame = Frame.WORLD,
        modes: ModeTable = MODES,
        surroundings: RobotSurroundings | None = None,
        jerk_time_s: float = 0.0,
    ) -> None:
        if not 0.0 <= jerk_time_s <= LONGEST_JERK_TIME_S:
            raise ControllerError(
                f"jerk time {jerk_time_s:g} s: choose one from 0 to {LONGEST_JERK_TIME_S:g} s; 0 sets no limit"
            )
        self.robot = robot
        self._table = modes
        self.command = OperatorCommand()
        self.frame = frame
        self.grip = self._next_grip = Grip.FREE
        self.held: HeldObject | None = None
        self.limitation: Limitation | None = None
        self.limits = IncrementLimits.of(robot, cycle_s)
        self._hands = Hands(robot)
        self.cycle_s = cycle_s
        self.surroundings, self.jerk_time_s = surroundings, jerk_time_s
        self._max_jerk: Array = (
            self.limits.max_ddq * (cycle_s / jerk_time_s) if jerk_time_s > 0.0 else np.full(robot.n, np.inf)
        )
        self._last = LastIncrement(self.limits.max_ddq)
        self._dq_before: Array = np.zeros(robot.n)
        self._modes: dict[DrivingMode, TeleoperationMode] = {}
        self._mode = self.mode_named(mode)
        self._next: TeleoperationMode | None = self._mode
        self._rest = Motion.rest(robot.n, len(self._hands.names))
        self._is_moving = False
        self.reflection = Reflection(cycle_s)
        self._settle_cycles = self._still_cycles = math.ceil(SETTLE_S / cycle_s)

    @property
    def mode(self) -> DrivingMode:
        """The mode that drives the robot now."""
        return self._mode.name

    @property
    def status(self) -> str:
        """The mode's status, beside what limits it."""
        return self._mode.status

    @property
    def arrived_at(self) -> int | None:
        """The advisor's option at which the robot rests; None elsewhere."""
        return self._mode.arrived_at

    @property
    def awaits_advice(self) -> bool:
        """Whether the advisor still looks for the option that was chosen, or for a path to it."""
        return self._mode.awaits_advice

    @property
    def hand_names(self) -> tuple[str, ...]:
        """Names of the robot's hands."""
        return self._hands.names

    @property
    def made_modes(self) -> tuple[TeleoperationMode, ...]:
        """The modes made so far."""
        return tuple(self._modes.values())

    @property
    def is_at_rest(self) -> bool:
        """Whether the last increment was zero, as requested and as admitted."""
        return not self._is_moving

    def mode_named(self, name: DrivingMode) -> TeleoperationMode:
        """The mode of that name, made when it is first asked for.

        Raises:
            ControllerError: the robot cannot be driven in it.
        """
        if name not in self._table:
            known = ", ".join(self._table)
            raise ControllerError(f"mode {name.value} is not available; there are {known}")
        if name not in self._modes:
            self._modes[name] = self._table[name](self.robot)
        return self._modes[name]

    def make_modes(self) -> None:
        """Make every mode that the robot can be driven in, for an operator who may switch to any of them."""
        for name in self._table:
            with suppress(ControllerError):  # the robot is not redundant
                self.mode_named(name)

    def check_grip(self, grip: Grip, mode: DrivingMode) -> None:
        """Check that the robot can grip in a mode.

        Raises:
            ControllerError: it has one hand, or the mode would part the hands.
        """
        if grip is Grip.FREE:
            return
        if len(self.hand_names) < 2:
            raise ControllerError(
                f"grip {grip.value}: robot {self.robot.name} has one hand, and an object is held by two or more"
            )
        if mode is DrivingMode.JOINT:
            raise ControllerError(
                f"mode {mode.value} moves each joint by itself and would separate hands that hold an object; "
                f"choose grip {Grip.FREE.value} first, or another mode"
            )

    def let_go(self) -> None:
        """Forget the grasp.

        While grip `object` is commanded, it is redefined at the present poses once the robot is at rest.
        """
        self.grip, self.held = Grip.FREE, None

    def check(self, command: OperatorCommand, mode: DrivingMode, grip: Grip = Grip.FREE) -> None:
        """Check that a command can be followed in a mode and with a grip.

        Raises:
            ControllerError: the robot has no such axis or output, or the mode does not drive it.
        """
        driver = self.mode_named(mode)
        self.check_grip(grip, mode)
        has = self.robot.description.outputs
        for name in command.outputs:
            if name not in has:
                raise ControllerError(
                    f"output {name!r} is unknown; robot {self.robot.name} has {', '.join(has) or 'no outputs'}"
                )
        joints = self.robot.joint_names
        if command.option is not None and mode is not DrivingMode.ADVISOR:
            raise ControllerError(f"option {command.option}: options are for mode advisor, not {mode.value}")
        for axis in command.rates:
            hand, _, plain = axis.rpartition(".")
            is_hand = plain in HAND_AXES and (not hand or hand in self.hand_names)
            if is_hand and hand and grip is Grip.OBJECT:
                raise ControllerError(
                    f"axis {axis!r} moves one hand alone, and the hands hold an object: {plain} moves it, "
                    f"or choose grip {Grip.FREE.value} first"
                )
            driven = driver.drives_hands if is_hand else axis in joints
            if not is_hand and driven:
                driven = bool(driver.drives_joints[joints.index(axis)])
            if not driven:
                known = "not driven in" if is_hand or axis in joints else "unknown to"
                drives = ", ".join(self.axes(mode)) or "to an option of its own"
                raise ControllerError(
                    f"axis {axis!r} is {known} mode {mode.value} of robot {self.robot.name}; it drives {drives}"
                )

    def axes(self, mode: DrivingMode) -> tuple[str, ...]:
        """The axes that an operator drives in a mode."""
        driver = self.mode_named(mode)
        named = zip(self.robot.joint_names, driver.drives_joints, strict=True)
        joints = tuple(name for name, driven in named if driven)
        if not driver.drives_hands:
            return joints
        several = self.hand_names if len(self.hand_names) > 1 else ()
        return (*joints, *HAND_AXES, *(f"{hand}.{axis}" for hand in several for axis in HAND_AXES))

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        # one kind of array: a read-only one would cause a compilation within a cycle
        q_cmd, dq_last = np.array(view.own.q_cmd, dtype=np.float64), self._last.update(view.own)
        if self.surroundings is not None:
            self.surroundings.update(view)
        moving = bool((np.abs(dq_last) > _STILL).any())
        self._take_command()
        self._still_cycles = 0 if moving else self._still_cycles + 1
        if self._next is not None and self._still_cycles >= self._settle_cycles:
            self._mode.leave()
            self._mode, self._next = self._next, None
            self._mode.enter(q_cmd)
        if self._next_grip is not self.grip and self._still_cycles >= self._settle_cycles:
            self._grip_at(q_cmd)
        is_settling = self._next is not None or self._next_grip is not self.grip
        asked = self._rest if is_settling else self._commanded(q_cmd)
        instant = Instant(
            q_cmd,
            np.array(dq_last, dtype=np.float64),
            self._dq_before,
            self.limits,
            self._max_jerk,
            self.cycle_s,
            self.surroundings,
            self.held,
        )
        dq, limitation = self._mode.advance(instant, asked)
        self._dq_before = instant.dq_last
        self._is_moving = moving or bool(dq.any())
        self.limitation = self._told(limitation) if asked else None
        share = share_of(asked, dq / self.cycle_s, self._hands)
        self.reflection.take(share, bool(asked), limitation is not None)
        return dq

    def take_verdict(self, verdict: Verdict | None) -> None:
        """Take the verdict on the increment; the gate's reason takes precedence over the mode's own."""
        if verdict is None:
            return
        self.reflection.take_verdict(verdict)
        found = from_verdict(verdict)
        if found is not None:
            self.limitation = self._told(found)

    def _told(self, limitation: Limitation | None) -> Limitation | None:
        return limitation if limitation is None or self.held is None else of_object(limitation)

    def _grip_at(self, q: Array) -> None:
        self.grip, self.held = self._next_grip, None
        if self.grip is Grip.OBJECT:
            self._hands.update(q)
            self.held = HeldObject(self._hands.rotations, self._hands.positions)

    def _take_command(self) -> None:
        if self.command.frame is not None:
            self.frame = self.command.frame
        if self.command.mode is not None:
            wanted = self.mode_named(self.command.mode)
            if wanted is not (self._next or self._mode):
                self._next = wanted
        if self.command.grip is not None:
            self._next_grip = self.command.grip
        self.check_grip(self._next_grip, (self._next or self._mode).name)
        self._mode.choose(self.command.option)

    def _commanded(self, q: Array) -> Motion:
        """The command as a motion of the axes that the mode drives."""
        rest = Motion.rest(self.robot.n, len(self.hand_names))
        if self.mode is DrivingMode.ADVISOR:
            return rest if self.command.option is None else replace(rest, along=1.0)
        return commanded(self.command, self.robot, self._hands, self._mode, self.frame, self.held, q)


SETTLE_S = 0.12
"""Time for which the setpoint is at rest before another mode takes over: the drives lag [s]."""

LONGEST_JERK_TIME_S = 1.0
"""Greatest `jerk_time_s`: a robot that takes longer to change its speed is not driven, but nudged [s]."""

_STILL = 1e-12
"""Increments below this count as zero [rad or m]."""
