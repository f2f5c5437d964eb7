"""The interface behind keyboard, gamepad, SpaceMouse, master arm, script and options."""

import asyncio
import math
from typing import Protocol, Self

import numpy as np

from deltaq_cell.roles import RoleError, camera_roles
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.live import cell_model
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.client import Cell
from deltaq_protocol.driving import TELEOPERATION, DrivingMode, Frame, Grip, OperatorCommand
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.pad_layout import VIEW_RANGE_M


class OperatorInput(Protocol):
    """Source of an operator's commands; a context manager, since some hold a device."""

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command at a time of the robot's clock [s]; empty while no input is touched, None at the end."""
        ...

    @property
    def status(self) -> str:
        """The present choice, for the operator."""
        return ""

    def reflect(self, share: float) -> None:
        """Let the operator's hand feel which fraction of the requested motion goes through, 0 to 1."""
        del share

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


# The dead zone of a stick or a cap: where it counts as let go.


DEAD_ZONE = 0.12
"""Deflection below which a stick counts as released; beyond it the speed grows from zero."""


def beyond_dead_zone(share: float) -> float:
    """Deflection from -1 to 1, zero in the dead zone and continuous at its edge."""
    beyond = (abs(share) - DEAD_ZONE) / (1.0 - DEAD_ZONE)
    return math.copysign(min(1.0, beyond), share) if beyond > 0.0 else 0.0


# What a key or a button of an operator's device chooses next.


OBJECT = Grip.OBJECT.value
"""In the place of a hand's name: all hands, which hold one object."""
SPEED_STEP = 1.5
_LEAST_SPEED_M_S, _GREATEST_SPEED_M_S = 0.005, 0.5


def choices_help(
    *, mode: str, frame: str, hand: str, speed: str, end: str, outputs: str, on: str, off: str
) -> str:
    """The choices of every device, and the keys or buttons that make them."""
    return (
        f"{mode} next mode, {frame} world/tool, {hand} next hand, {speed} speed, {end} ends\n"
        f"outputs: {outputs} next, {on} on, {off} off"
    )


def next_mode(teleoperator: Teleoperator) -> DrivingMode:
    """The next mode after the present one that the robot supports."""
    modes = TELEOPERATION
    place = modes.index(teleoperator.mode)
    for offset in range(1, len(modes)):
        mode = modes[(place + offset) % len(modes)]
        try:
            teleoperator.mode_named(mode)
            teleoperator.check_grip(teleoperator.grip, mode)
        except ControllerError:
            continue  # this robot is not redundant, or holds an object
        return mode
    return teleoperator.mode


def next_hand(teleoperator: Teleoperator, hand: str | None) -> str | None:
    """The hand after this one; None is all of them, `OBJECT` all of them with an object between them."""
    hands: tuple[str | None, ...] = (None, *teleoperator.hand_names)
    if len(hands) > 2 and teleoperator.mode is not DrivingMode.JOINT:
        hands += (OBJECT,)
    return hands[(hands.index(hand) + 1) % len(hands)] if hand in hands else None


def grip_of(teleoperator: Teleoperator, hand: str | None) -> Grip | None:
    """The grip of a choice of hand; None for a robot with one hand."""
    if len(teleoperator.hand_names) < 2:
        return None
    return Grip.OBJECT if hand == OBJECT else Grip.FREE


def led_hand(hand: str | None) -> str:
    """The hand that a master leads for a choice of hand, as `OperatorCommand.led` has it."""
    return "" if hand in (None, OBJECT) else hand


def hand_axis(hand: str | None, axis: str) -> str:
    """The name of the commanded axis for a choice of hand."""
    return axis if hand in (None, OBJECT) else f"{hand}.{axis}"


def other_frame(teleoperator: Teleoperator) -> Frame:
    """The other frame: tool if hands move in world axes, and the reverse."""
    return Frame.WORLD if teleoperator.frame is Frame.TOOL else Frame.TOOL


def changed_speed(speed_m_s: float, is_faster: bool) -> float:
    """The next hand speed, up or down, within its bounds [m/s]."""
    factor = SPEED_STEP if is_faster else 1.0 / SPEED_STEP
    return min(_GREATEST_SPEED_M_S, max(_LEAST_SPEED_M_S, factor * speed_m_s))


class OutputChoice:
    """The choice of the digital output to switch.

    On and off are separate commands, so it does no harm to press one twice, or without knowing the output's value.

    Args:
        teleoperator: the teleoperator of the robot that has the outputs.

    Attributes:
        name: of the output; empty if the robot has none.
    """

    def __init__(self, teleoperator: Teleoperator) -> None:
        self._names = teleoperator.robot.description.outputs
        self.name = self._names[0] if self._names else ""

    def next(self) -> None:
        """Choose the one after it."""
        if self._names:
            self.name = self._names[(self._names.index(self.name) + 1) % len(self._names)]

    def switched(self, is_on: bool) -> dict[str, bool]:
        """The command that switches it; empty if the robot has none."""
        return {self.name: is_on} if self.name else {}


# The view distance of the camera that watches a robot, changed in steps while that robot is driven.


def stepped(now_m: float, step_m: float) -> float:
    """The view distance a step on from `now_m`, in whole centimetres within `VIEW_RANGE_M` [m]."""
    least_m, most_m = VIEW_RANGE_M
    return round(min(most_m, max(least_m, now_m + step_m)), 2)


class AskedViewDistance:
    """Asks a robot's follower for another view distance, outside the control loop.

    Args:
        cell: connection to the cell.
        robot: the robot that is watched.

    Attributes:
        status: result of the last step, for the operator.
    """

    def __init__(self, cell: Cell, robot: str) -> None:
        self._cell, self._robot = cell, robot
        self._asked_m: float | None = None
        self._task: asyncio.Task[None] | None = None
        self.status = ""
        described = cell_model(cell.description)
        try:
            self._camera = camera_roles(described.description, leader=robot).follower
        except RoleError:
            self._camera = ""
            return
        self._follower = described.robots[self._camera]

    def change(self, step_m: float) -> None:
        """Look from nearer, or from farther away [m]; nothing in a cell where no camera watches the robot."""
        now_m = self._now_m() if self._camera else None
        if now_m is None:
            self.status = f"no camera watches {self._robot}"
            return
        self._asked_m = stepped(now_m, step_m)
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._ask())

    def _now_m(self) -> float | None:
        """The distance that is asked for now, else the one from lens to tool; None if neither robot is seen."""
        if self._asked_m is not None:
            return self._asked_m
        follower, watched = self._cell.state(self._camera), self._cell.state(self._robot)
        if follower is None or watched is None:
            return None
        if follower.view is not None and follower.view.distance_m is not None:
            return follower.view.distance_m
        lens = self._follower.camera_pose(follower.q)[:3, 3]
        return float(np.linalg.norm(np.array(watched.tool.position) - lens))

    async def _ask(self) -> None:
        """Ask for the newest step; those that come meanwhile are asked for at once."""
        while (asked_m := self._asked_m) is not None:
            try:
                reply = await self._cell.view(self._camera, distance_m=asked_m)
            except DeltaqError as error:
                self.status = f"view: {error}"
                self._asked_m = None
                return
            self.status = f"view {asked_m:.2f} m" + (
                "" if reply.holder else f", no follower runs on {self._camera}"
            )
            if self._asked_m == asked_m:
                self._asked_m = None
