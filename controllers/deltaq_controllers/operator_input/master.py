"""Another robot of the cell as an input device: its tool leads a hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import pinocchio as pin

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError, RobotView
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput, hand_axis
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.driving import HAND_AXES, Frame, OperatorCommand

# The motion of one tool as the command for another one. Pure: the caller passes poses.


PULL_1_S = 4.0
"""Rate at which the remaining displacement is made up [1/s]."""
SLACK_M, SLACK_RAD = 0.05, 0.2
"""The hand is pulled by no more: where it could not follow, the master's way back moves it at once [m, rad]."""
SMOOTHED_S = 0.05
"""Time constant of the measured twist [s]."""
JUMP_M, JUMP_RAD = 0.1, 0.5
"""A master that is so far off from one look to the next has not moved there [m, rad]."""


class PlacedTool(NamedTuple):
    """The pose of a tool.

    Attributes:
        rotation: (3, 3) its axes in the world.
        position: (3,) its origin in the world [m].
    """

    rotation: Array
    position: Array


@dataclass
class _Anchor:
    """Where both were as they were coupled; the hand's moves along where it cannot follow.

    Attributes:
        axes: (3, 3) takes the master's way and turn to those of the hand.
    """

    master: PlacedTool
    hand: PlacedTool
    axes: Array


class LedPose:
    """Leads a hand by a master's tool: the hand makes the tool's displacement since coupling, times a scale.

    Displacements are scaled, rotations are not. Both are in world axes, or with `own_axes` each in the axes of its own
    tool at the coupling.

    Args:
        scale: displacement of the hand for each metre of the master's.
    """

    def __init__(self, scale: float) -> None:
        self._scale = scale
        self._anchor: _Anchor | None = None
        self._seen: tuple[float, PlacedTool] | None = None
        self._twist: Array = np.zeros(6)

    @property
    def is_coupled(self) -> bool:
        """Whether the hand is led."""
        return self._anchor is not None

    def release(self) -> None:
        """Uncouple the hand."""
        self._anchor = self._seen = None
        self._twist = np.zeros(6)

    def couple(self, master: PlacedTool, hand: PlacedTool, own_axes: bool) -> None:
        """Couple the hand to the master at their present poses.

        Args:
            master: its tool, as measured.
            hand: the led hand, as commanded.
            own_axes: map the displacement from the axes of the master's tool to those of the hand.
        """
        self.release()
        self._anchor = _Anchor(master, hand, hand.rotation @ master.rotation.T if own_axes else np.eye(3))

    def twist(self, time_s: float, master: PlacedTool, hand: PlacedTool) -> Array | None:
        """The commanded twist (6,) of the hand, world axes [m/s, rad/s]; None if the master jumped.

        Args:
            time_s: stamp of the master's pose on its own clock [s].
            master: its tool, as measured.
            hand: the led hand, as commanded.
        """
        anchor = self._anchor
        assert anchor is not None  # coupled
        if not self._measure(time_s, master):
            self.release()
            return None
        way = self._scale * (anchor.axes @ (master.position - anchor.master.position))
        turn = pin.exp3(anchor.axes @ pin.log3(master.rotation @ anchor.master.rotation.T))
        left = _clipped(anchor.hand.position + way - hand.position, SLACK_M)
        askew = _clipped(pin.log3(turn @ anchor.hand.rotation @ hand.rotation.T), SLACK_RAD)
        # displacement beyond the slack is dropped
        anchor.hand = PlacedTool(turn.T @ pin.exp3(askew) @ hand.rotation, hand.position + left - way)
        ahead = np.concatenate([self._scale * (anchor.axes @ self._twist[:3]), anchor.axes @ self._twist[3:]])
        wished: Array = ahead + PULL_1_S * np.concatenate([left, askew])
        return wished

    def _measure(self, time_s: float, master: PlacedTool) -> bool:
        """Take a pose of the master into its twist; whether it can have moved there."""
        if self._seen is None:
            self._seen = time_s, master
            return True
        before_s, before = self._seen
        if time_s <= before_s:
            return time_s == before_s
        moved = np.concatenate(
            [master.position - before.position, pin.log3(master.rotation @ before.rotation.T)]
        )
        if np.linalg.norm(moved[:3]) > JUMP_M or np.linalg.norm(moved[3:]) > JUMP_RAD:
            return False
        step_s = time_s - before_s
        follows = 1.0 - math.exp(-step_s / SMOOTHED_S)
        self._twist = self._twist + follows * (moved / step_s - self._twist)
        self._seen = time_s, master
        return True


def _clipped(vector: Array, size: float) -> Array:
    return vector * min(1.0, size / max(float(np.linalg.norm(vector)), 1e-12))


HELP = "the master leads the hand while c was the last key, or while a motion button is held"
STALE_S = 0.15
"""A master without a new state for this time is lost, and must be coupled again [s]."""
MOST_M_S, MOST_RAD_S = 0.5, 1.75
"""Greatest speed that a master asks for."""

STILL, REST_S = 0.002, 0.1
"""A master counts once none of its joints has moved farther [rad or m] for so long [s] since it was found."""

LookAtBoth = Callable[[], tuple[RobotView | None, RobotView | None]]
"""The newest views of the master and of the robot that is driven."""


def looking_at(cell: Cell, master: str, robot: str) -> LookAtBoth:
    """Looks at two robots of a running cell."""

    def look() -> tuple[RobotView | None, RobotView | None]:
        states = (cell.state(master), cell.state(robot))
        first, second = (None if state is None else RobotView.from_state(state) for state in states)
        return first, second

    return look


class Master:
    """Computes the rates of a hand from the measured motion of another robot's tool, while commands ask for it.

    A master leads only after it has been at rest. If it jumps or its states stop, it is uncoupled until the operator
    couples it again.

    Args:
        teleoperator: the robot that is driven.
        master: the robot that leads.
        look: returns the states of both.
        scale: travel of the hand for each metre of the master's.

    Attributes:
        name: of the master.
        scale: as given.

    Raises:
        ControllerError: a robot cannot lead itself.
    """

    def __init__(
        self, teleoperator: Teleoperator, master: RobotModel, look: LookAtBoth, scale: float
    ) -> None:
        if master.name == teleoperator.robot.name:
            raise ControllerError(f"master {master.name}: a robot cannot lead itself; name another one")
        self._teleoperator, self._look = teleoperator, look
        self.name, self.scale = master.name, scale
        self._master, self._hands = Hands(master), Hands(teleoperator.robot)
        self._led = LedPose(scale)
        self._choice: tuple[object, ...] = ()
        self._must_release = False
        self._seen: tuple[int, float] | None = None
        self._trouble = ""
        self._stands: tuple[float, Array] | None = None
        self._has_rested = False

    @property
    def status(self) -> str:
        """Text: whether the master leads, and if not, why."""
        led = "leads" if self._led.is_coupled else self._trouble or "is not coupled"
        return f"{self.name} {led}"

    def lead(self, command: OperatorCommand, time_s: float) -> OperatorCommand:
        """Put the master's rates into a command that has its hand led; other commands are returned unchanged.

        Call it in every cycle, led or not, with the time of the driven robot's clock [s].
        """
        if command.led is None:
            self._must_release, self._trouble = False, ""
            self._led.release()
            self._watch(time_s)
            return command
        return replace(command, rates=self._rates(command.led, time_s))

    def _rates(self, led: str, time_s: float) -> dict[str, float]:
        seen = self._watch(time_s)
        teleoperator = self._teleoperator
        if not teleoperator.mode_named(teleoperator.mode).drives_hands:
            self._uncouple(f"leads no hand in mode {teleoperator.mode.value}")
        elif seen is None:
            self._uncouple("sends no state: couple it again")
        elif not self._has_rested:
            self._uncouple("moves: let it rest, then couple it")
        if seen is None or self._must_release:
            return {}
        master, own = seen
        hand, poses = self._hand(led, own.q_cmd), self._tool(master.q)
        own_axes = teleoperator.frame is Frame.TOOL
        choice = (led, teleoperator.mode, teleoperator.frame, teleoperator.grip)
        if not self._led.is_coupled or choice != self._choice:
            self._choice = choice
            self._led.couple(poses, hand, own_axes)
        twist = self._led.twist(master.time_s, poses, hand)
        if twist is None:
            self._uncouple("jumped: couple it again")
            return {}
        return self._commanded(led, twist, hand, own_axes)

    def _commanded(self, led: str, twist: Array, hand: PlacedTool, own_axes: bool) -> dict[str, float]:
        axes = hand.rotation.T if own_axes else np.eye(3)
        parts = ((axes @ twist[:3], MOST_M_S), (axes @ twist[3:], MOST_RAD_S))
        rates = [part * min(1.0, most / max(float(np.linalg.norm(part)), 1e-12)) for part, most in parts]
        named = zip(HAND_AXES, np.concatenate(rates).tolist(), strict=True)
        return {hand_axis(led or None, axis): rate for axis, rate in named}

    def _uncouple(self, trouble: str) -> None:
        self._led.release()
        self._must_release, self._trouble = True, trouble

    def _watch(self, time_s: float) -> tuple[RobotView, RobotView] | None:
        """The newest views of both robots; None if the master's states have ceased."""
        master, own = self._look()
        if master is None or own is None:
            return None
        if self._seen is None or self._seen[0] != master.cycle:
            self._seen = master.cycle, time_s
        if time_s - self._seen[1] > STALE_S:
            self._stands, self._has_rested = None, False
            return None
        if self._stands is None or np.abs(master.q - self._stands[1]).max() > STILL:
            self._stands = time_s, master.q
        self._has_rested |= time_s - self._stands[0] >= REST_S
        return master, own

    def _tool(self, q: Array) -> PlacedTool:
        self._master.place(q)
        return PlacedTool(self._master.rotations[0], self._master.positions[0])

    def _hand(self, led: str, q: Array) -> PlacedTool:
        """The hand that is led; of several the middle, with the axes of the object between them or of the first."""
        hands, held = self._hands, self._teleoperator.held
        hands.place(q)
        if led in hands.names:
            chosen = hands.names.index(led)
            return PlacedTool(hands.rotations[chosen], hands.positions[chosen])
        rotation = hands.rotations[0] if held is None else held.axes(hands.rotations)
        return PlacedTool(rotation, hands.positions.mean(axis=0))


class LedInput(OperatorInput):
    """A device by which an operator couples a master, and chooses everything else.

    Args:
        device: in the operator's hand.
        master: leads the hand while the device's commands say so.
    """

    def __init__(self, device: OperatorInput, master: Master) -> None:
        self._device, self._master = device, master

    @property
    def status(self) -> str:
        """The present choice, and whether the master leads."""
        return f"{self._device.status}, {self._master.status}"

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command at a time of the driven robot's clock [s]; None when the operator ends the drive."""
        command = self._device.read(time_s)
        return None if command is None else self._master.lead(command, time_s)

    def reflect(self, share: float) -> None:
        """Pass the executed fraction to a device with force feedback."""
        self._device.reflect(share)

    def __enter__(self) -> Self:
        self._device.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._device.__exit__()
