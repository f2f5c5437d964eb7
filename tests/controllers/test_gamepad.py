"""`deltaq drive --input gamepad`, with a virtual gamepad of SDL in the place of a real one."""

from __future__ import annotations

import asyncio
import ctypes
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self, cast

import numpy as np
import pytest
from advising import advised
from driving import CYCLE_S, PlainDrive, model
from first_cycles import QuietCell, Waits

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.live import ControlStatistics
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.gamepad import SETTLE_S, Gamepad, PadButton, StickAxis, Trigger
from deltaq_controllers.operator_input.interface import DEAD_ZONE, AskedViewDistance
from deltaq_controllers.teleoperation import teleoperate
from deltaq_protocol.driving import DrivingMode, Grip, OperatorCommand
from deltaq_protocol.pad_layout import PAD_LAYOUT, PadFunction

_Rumble = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_uint16, ctypes.c_uint16)


class _Description(ctypes.Structure):
    """SDL_VirtualJoystickDesc, version 1."""

    _fields_ = (
        *((name, ctypes.c_uint16) for name in ("version", "type", "naxes", "nbuttons", "nhats")),
        *((name, ctypes.c_uint16) for name in ("vendor_id", "product_id", "padding")),
        *((name, ctypes.c_uint32) for name in ("button_mask", "axis_mask")),
        ("name", ctypes.c_char_p),
        *((name, ctypes.c_void_p) for name in ("userdata", "Update", "SetPlayerIndex")),
        ("Rumble", _Rumble),
        *((name, ctypes.c_void_p) for name in ("RumbleTriggers", "SetLED", "SendEffect")),
    )


_JOYSTICK, _GAMECONTROLLER = 0x200, 1
_AXES, _BUTTONS = 6, 15
_TRIGGERS = (4, 5)


def _sdl() -> ctypes.CDLL:
    """The SDL that pygame-ce has loaded into this process."""
    import pygame  # noqa: F401 -- loads it

    lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    library = ctypes.CDLL(next(line.split()[-1] for line in lines if "libSDL2-" in line))
    library.SDL_JoystickOpen.restype = ctypes.c_void_p
    library.SDL_GetError.restype = ctypes.c_char_p
    return library


class VirtualPad:
    """A gamepad that is plugged in for the length of the block, or as long as it is not pulled out.

    Attributes:
        rumbles: strength of each rumble that it was told, 0 to 1; one of a pad `without_motors` is told none.
            One of `unknown_type` has no mapping.
    """

    def __init__(self, without_motors: bool = False, unknown_type: bool = False) -> None:
        self._sdl = _sdl()
        self.rumbles: list[float] = []
        self._description = _Description(
            version=1,
            type=0 if unknown_type else _GAMECONTROLLER,
            naxes=_AXES,
            nbuttons=_BUTTONS,
            name=b"Virtual Controller",
        )
        if not without_motors:
            self._description.Rumble = _Rumble(self._rumble)
        self._pad: ctypes.c_void_p | None = None
        self._index = -1

    def _rumble(self, _: object, low: int, high: int) -> int:
        self.rumbles.append(max(low, high) / 65535)
        return 0

    def plug_in(self) -> None:
        self._index = self._sdl.SDL_JoystickAttachVirtualEx(ctypes.byref(self._description))
        assert self._index >= 0, self._sdl.SDL_GetError()
        self._pad = ctypes.c_void_p(self._sdl.SDL_JoystickOpen(self._index))
        for trigger in _TRIGGERS:
            self.pull(trigger, 0.0)

    def pull_out(self) -> None:
        assert self._sdl.SDL_JoystickDetachVirtual(self._index) == 0, self._sdl.SDL_GetError()
        self._sdl.SDL_JoystickClose(self._pad)
        self._pad = None

    def push(self, axis: int, share: float) -> None:
        assert self._sdl.SDL_JoystickSetVirtualAxis(self._pad, axis, round(32767 * share)) == 0

    def pull(self, axis: int, share: float) -> None:
        # a trigger's way is all of its axis
        assert self._sdl.SDL_JoystickSetVirtualAxis(self._pad, axis, round(65535 * share) - 32768) == 0

    def press(self, *buttons: int) -> None:
        for button in buttons:
            assert self._sdl.SDL_JoystickSetVirtualButton(self._pad, button, 1) == 0
        self._sdl.SDL_JoystickUpdate()

    def release(self, *buttons: int) -> None:
        for button in buttons:
            assert self._sdl.SDL_JoystickSetVirtualButton(self._pad, button, 0) == 0
        self._sdl.SDL_JoystickUpdate()

    def __enter__(self) -> Self:
        assert self._sdl.SDL_InitSubSystem(_JOYSTICK) == 0, self._sdl.SDL_GetError()
        self.plug_in()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pad is not None:
            self.pull_out()
        self._sdl.SDL_QuitSubSystem(_JOYSTICK)


REST = OperatorCommand()
AHEAD = (StickAxis.LEFT_Y, -1.0)
MOVE, TURN = PadButton.LEFT_SHOULDER, PadButton.RIGHT_SHOULDER


def teleoperator(robot: str = "gr", mode: DrivingMode = DrivingMode.COUPLED) -> Teleoperator:
    return Teleoperator(model(robot), CYCLE_S, mode)


@pytest.fixture
def pad(monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualPad]:
    # a real pad that is plugged in here is not looked at; the virtual one has no maker and no product
    monkeypatch.setenv("SDL_GAMECONTROLLER_IGNORE_DEVICES_EXCEPT", "0x0000/0x0000")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with VirtualPad() as pad:
        yield pad


class Settled(Gamepad):
    """A gamepad whose pad was found a while ago; time goes on by a cycle with each look."""

    time_s = 0.0

    def look(self) -> OperatorCommand:
        self.time_s += CYCLE_S
        command = self.read(self.time_s)
        assert command is not None
        return command

    def __enter__(self) -> Settled:
        super().__enter__()
        self.settle()
        return self

    def settle(self) -> None:
        assert replace(self.look(), grip=None) == REST
        self.time_s += SETTLE_S
        assert replace(self.look(), grip=None) == REST


# --- what must not move ---------------------------------------------------------------------------------------


def test_a_missing_gamepad_is_reported_with_alternatives(pad: VirtualPad) -> None:
    pad.pull_out()
    with pytest.raises(ControllerError, match=r"no gamepad is plugged in.* use the keyboard or `--script`"):
        Gamepad(teleoperator()).__enter__()


def test_a_joystick_without_a_mapping_is_refused_by_name(pad: VirtualPad) -> None:
    pad.pull_out()
    with (
        VirtualPad(unknown_type=True),
        pytest.raises(
            ControllerError, match=r"Virtual Controller: not used, since SDL has no mapping for it"
        ),
    ):
        Gamepad(teleoperator()).__enter__()


def test_keys_held_at_the_start_of_a_drive_must_be_released_first(pad: VirtualPad) -> None:
    pad.press(MOVE)
    pad.push(*AHEAD)
    with Settled(teleoperator()) as gamepad:
        assert gamepad.look() == REST, "neither was meant for the robot"
        pad.release(MOVE)
        assert gamepad.look() == REST
        pad.press(MOVE)
        pad.press(PadButton.Y)
        assert gamepad.look() == REST, "the stick is still pushed"
        assert gamepad.status == "let go of left y: nothing moves until each was at rest; B ends"
        pad.push(StickAxis.LEFT_Y, 0.0)
        assert gamepad.look() == REST, "the button was held as the pad was armed"
        pad.release(MOVE)
        pad.press(MOVE)
        pad.push(*AHEAD)
        assert gamepad.look().rates["x"] == pytest.approx(0.1)


def test_a_stick_or_trigger_never_at_rest_disables_everything_but_the_end_button(
    pad: VirtualPad,
) -> None:
    # as a trigger does whose axis is taken for a stick's
    pad.push(StickAxis.RIGHT_Y, -1.0)
    pad.pull(Trigger.LEFT, 0.5)
    with Settled(teleoperator()) as gamepad:
        pad.press(MOVE, PadButton.A, PadButton.RIGHT)
        pad.push(*AHEAD)
        pad.pull(Trigger.RIGHT, 1.0)
        assert gamepad.look() == REST
        assert gamepad.status.startswith("let go of right y, left trigger:")
        assert (gamepad.hand, gamepad.status.count("m/s")) == (None, 0)
        pad.press(PadButton.B)
        assert gamepad.read(gamepad.time_s + CYCLE_S) is None


def test_events_at_the_connection_of_a_pad_are_no_press(pad: VirtualPad) -> None:
    with Gamepad(teleoperator()) as gamepad:
        assert gamepad.read(0.0) == REST
        # as a pad does whose first report comes late
        pad.press(MOVE, PadButton.Y, PadButton.B)
        pad.push(*AHEAD)
        assert gamepad.read(0.5 * SETTLE_S) == REST
        assert gamepad.read(2.0 * SETTLE_S) == REST


def test_an_unplugged_pad_means_rest_and_resumes_when_plugged_in(pad: VirtualPad) -> None:
    with Settled(teleoperator()) as gamepad:
        pad.press(MOVE)
        pad.push(*AHEAD)
        assert gamepad.look().rates["x"] == pytest.approx(0.1)
        pad.pull_out()
        assert gamepad.look() == REST
        assert gamepad.status == "the gamepad is unplugged: rest"
        pad.plug_in()
        pad.press(MOVE)
        gamepad.settle()
        assert gamepad.look() == REST, "it has to be pressed anew"
        pad.release(MOVE)
        assert gamepad.look() == REST
        pad.press(MOVE)
        pad.push(*AHEAD)
        assert gamepad.look().rates["x"] == pytest.approx(0.1)


def test_a_second_pad_is_ignored(pad: VirtualPad) -> None:
    with Settled(teleoperator()) as gamepad, VirtualPad() as other:
        other.press(MOVE, PadButton.B)
        other.push(*AHEAD)
        assert gamepad.look() == REST


def test_the_sticks_count_only_while_a_shoulder_button_is_held(pad: VirtualPad) -> None:
    with Settled(teleoperator()) as gamepad:
        pad.push(*AHEAD)
        assert gamepad.look() == REST
        pad.press(MOVE)
        assert gamepad.look().rates["x"] == pytest.approx(0.1)
        pad.release(MOVE)
        assert gamepad.look() == REST


def test_a_trigger_pulled_at_the_start_switches_nothing_until_it_was_released(
    pad: VirtualPad,
) -> None:
    pad.pull(Trigger.RIGHT, 1.0)
    with Settled(teleoperator()) as gamepad:
        assert gamepad.look() == REST
        pad.pull(Trigger.RIGHT, 0.5)
        assert gamepad.look() == REST
        pad.pull(Trigger.RIGHT, 1.0)
        assert gamepad.look() == REST, "it was not let go"
        pad.pull(Trigger.RIGHT, 0.0)
        assert gamepad.look() == REST
        pad.pull(Trigger.RIGHT, 1.0)
        assert gamepad.look() == OperatorCommand(outputs={"gripper": True})


# --- what moves -------------------------------------------------------------------------------------------------


def test_speed_grows_from_zero_at_the_edge_of_the_dead_zone(pad: VirtualPad) -> None:
    with Settled(teleoperator()) as gamepad:
        pad.press(MOVE)
        told = []
        for share in (0.0, DEAD_ZONE - 0.01, DEAD_ZONE + 0.01, 0.5 * (1.0 + DEAD_ZONE), 1.0):
            pad.push(StickAxis.LEFT_Y, -share)
            told.append(gamepad.look().rates["x"])
    assert told == pytest.approx([0.0, 0.0, 0.1 * 0.01 / (1.0 - DEAD_ZONE), 0.05, 0.1], abs=1e-5)


@pytest.mark.parametrize(
    ("button", "stick", "share", "rates"),
    [
        (MOVE, StickAxis.LEFT_Y, -1.0, {"x": 0.1, "y": 0.0, "z": 0.0}),
        (MOVE, StickAxis.LEFT_X, -1.0, {"x": 0.0, "y": 0.1, "z": 0.0}),
        (MOVE, StickAxis.RIGHT_Y, 1.0, {"x": 0.0, "y": 0.0, "z": -0.1}),
        (TURN, StickAxis.LEFT_Y, -1.0, {"rx": 0.35, "ry": 0.0, "rz": 0.0}),
        (TURN, StickAxis.RIGHT_Y, -1.0, {"rx": 0.0, "ry": 0.0, "rz": 0.35}),
    ],
)
def test_the_left_shoulder_button_moves_and_the_right_one_turns(
    pad: VirtualPad, button: PadButton, stick: StickAxis, share: float, rates: dict[str, float]
) -> None:
    with Settled(teleoperator()) as gamepad:
        pad.press(button)
        pad.push(stick, share)
        assert gamepad.look().rates == pytest.approx(rates, abs=1e-4)


def test_a_tap_between_two_readings_counts_once(pad: VirtualPad) -> None:
    with Settled(teleoperator(mode=DrivingMode.JOINT)) as gamepad:
        pad.press(PadButton.RIGHT)
        pad.release(PadButton.RIGHT)
        gamepad.look()
        gamepad.look()
        assert gamepad.joint == 1


def test_the_stick_drives_the_joint_chosen_by_the_d_pad(pad: VirtualPad) -> None:
    with Settled(teleoperator(mode=DrivingMode.SELF_MOTION)) as gamepad:
        pad.press(TURN, PadButton.LEFT)
        pad.push(*AHEAD)
        assert gamepad.look() == OperatorCommand({"a6": pytest.approx(0.35)}, led="")
        assert gamepad.status == "joint a6, output gripper, 0.100 m/s, held"


class Steps:
    """In the place of the view distance of a camera."""

    status = "view 1.00 m"

    def __init__(self) -> None:
        self.steps_m: list[float] = []

    def change(self, step_m: float) -> None:
        self.steps_m.append(step_m)


@pytest.mark.parametrize(
    ("function", "mode", "does"),
    [
        (PadFunction.MOVE, DrivingMode.COUPLED, {"x"}),
        (PadFunction.TURN, DrivingMode.COUPLED, {"rx"}),
        (PadFunction.STOP, DrivingMode.COUPLED, {"ends"}),
        (PadFunction.MODE, DrivingMode.COUPLED, {"joint"}),
        (PadFunction.FRAME, DrivingMode.COUPLED, {"tool"}),
        (PadFunction.HAND, DrivingMode.COUPLED, {"the next hand"}),
        (PadFunction.OUTPUT, DrivingMode.COUPLED, {"tool_changer"}),
        (PadFunction.ON, DrivingMode.COUPLED, {"gripper True"}),
        (PadFunction.OFF, DrivingMode.COUPLED, {"gripper False"}),
        (PadFunction.NEARER, DrivingMode.COUPLED, {"-0.1 m"}),
        (PadFunction.FARTHER, DrivingMode.COUPLED, {"+0.1 m"}),
        (PadFunction.PREVIOUS, DrivingMode.COUPLED, {"0.067 m/s"}),
        (PadFunction.NEXT, DrivingMode.COUPLED, {"0.150 m/s"}),
        (PadFunction.NEXT, DrivingMode.JOINT, {"joint 1"}),
        (PadFunction.ROBOT, DrivingMode.COUPLED, set()),
        (PadFunction.PICTURE, DrivingMode.COUPLED, set()),
    ],
)
def test_every_control_follows_the_layout_shared_with_the_console(
    pad: VirtualPad, function: PadFunction, mode: DrivingMode, does: set[str]
) -> None:
    (name,) = (control.name for control in PAD_LAYOUT if control.function is function)
    view = Steps()
    with Settled(teleoperator(mode=mode), view=cast(AskedViewDistance, view)) as gamepad:
        if name.endswith("_trigger"):
            trigger = Trigger[name.removesuffix("_trigger").upper()]
            pad.pull(trigger, 0.0)
            gamepad.look()
            pad.pull(trigger, 1.0)
        else:
            pad.press(PadButton[name.upper()])
        pad.push(*AHEAD)
        command = gamepad.read(gamepad.time_s + CYCLE_S)
        if command is None:
            did = {"ends"}
        else:
            did = {axis for axis, rate in command.rates.items() if rate}
            did |= {f"{output} {is_on}" for output, is_on in command.outputs.items()}
            did |= {choice.value for choice in (command.mode, command.frame) if choice is not None}
        did |= {"the next hand"} if gamepad.hand is not None else set()
        did |= {gamepad.output.name} - {"gripper"}
        did |= {f"joint {gamepad.joint}"} - {"joint 0"}
        did |= {part for part in gamepad.status.split(", ") if part.endswith("m/s")} - {"0.100 m/s"}
        did |= {f"{step_m:+.1f} m" for step_m in view.steps_m}
    assert did == does


def test_a_pushed_stick_drives_to_the_chosen_option(pad: VirtualPad) -> None:
    with Settled(advised(model("gr"))) as gamepad:
        pad.press(TURN, PadButton.RIGHT)
        assert gamepad.look() == OperatorCommand(led="")
        assert gamepad.status == "option 2, output gripper, 0.100 m/s, held"
        pad.push(*AHEAD)
        assert gamepad.look() == OperatorCommand(option=2, led="")
        pad.release(TURN)
        assert gamepad.look() == REST


def test_the_right_trigger_switches_the_chosen_output_on_and_the_left_one_off_each_once(
    pad: VirtualPad,
) -> None:
    with Settled(teleoperator()) as gamepad:
        for trigger in Trigger:
            pad.pull(trigger, 0.0)
        gamepad.look()
        pad.press(MOVE)
        pad.push(*AHEAD)
        pad.pull(Trigger.RIGHT, 1.0)
        command = gamepad.look()
        assert command.outputs == {"gripper": True}
        assert command.rates["x"] == pytest.approx(0.1), "the hand goes on"
        pad.pull(Trigger.RIGHT, 0.9)
        assert gamepad.look().outputs == {}, "it is still pulled"
        pad.press(PadButton.START)
        pad.pull(Trigger.LEFT, 1.0)
        assert gamepad.look().outputs == {"tool_changer": False}
        assert "output tool_changer" in gamepad.status


def test_a_button_cycles_through_the_hands_and_the_object_and_moves_the_chosen_one(
    pad: VirtualPad,
) -> None:
    driven = teleoperator("dawm")
    with Settled(driven) as gamepad:
        pad.press(MOVE)
        pad.push(*AHEAD)
        told = []
        for _ in range(5):
            command = gamepad.look()
            told.append((gamepad.hand, [axis for axis, rate in command.rates.items() if rate], command.grip))
            pad.press(PadButton.A)
            pad.release(PadButton.A)
    assert told == [
        (None, ["x"], Grip.FREE),
        ("left", ["left.x"], Grip.FREE),
        ("right", ["right.x"], Grip.FREE),
        ("object", ["x"], Grip.OBJECT),
        (None, ["x"], Grip.FREE),
    ]


def test_only_the_hand_chosen_by_the_pad_moves(pad: VirtualPad) -> None:
    run = PlainDrive("dawm", DrivingMode.COUPLED)
    hands = Hands(run.robot)
    hands.place(run.now)
    start = hands.positions
    with Settled(run.teleoperator) as gamepad:
        moved = []
        pad.press(PadButton.A)
        pad.press(MOVE)
        for _ in range(2):
            pad.push(*AHEAD)
            for _ in range(40):
                run.step(gamepad.look())
            pad.push(StickAxis.LEFT_Y, 0.0)
            for _ in range(40):
                run.step(gamepad.look())
            hands.place(run.now)
            moved.append(np.linalg.norm(hands.positions - start, axis=1))
            pad.release(PadButton.A)
            pad.press(PadButton.A)
    assert moved[0][0] > 0.01
    assert moved[0][1] == pytest.approx(0.0, abs=1e-5)
    assert moved[1][0] == pytest.approx(moved[0][0], abs=1e-5)
    assert moved[1][1] > 0.01


def test_a_pad_without_rumble_motors_works() -> None:
    with VirtualPad(without_motors=True) as still, Settled(teleoperator()) as gamepad:
        for _ in range(3):
            gamepad.look()
            gamepad.reflect(0.0)
        assert still.rumbles == []


def test_the_pad_rumbles_more_if_less_of_the_command_is_executed_and_stops_with_the_drive(
    pad: VirtualPad,
) -> None:
    with Settled(teleoperator()) as gamepad:
        gamepad.look()
        gamepad.reflect(1.0)
        assert pad.rumbles == [], "nothing limits"
        for share in (0.5, 0.49, 0.0):
            gamepad.look()
            gamepad.reflect(share)
        assert pad.rumbles == pytest.approx([0.5, 1.0], abs=1e-3), "a small change is not told again"
    assert pad.rumbles[2:] == [0.0]


def test_the_view_distance_is_shown_beside_the_speed(pad: VirtualPad) -> None:
    with Settled(teleoperator(), view=cast(AskedViewDistance, Steps())) as gamepad:
        assert "0.100 m/s, view 1.00 m, hold a shoulder button" in gamepad.status


@pytest.mark.long
async def test_a_robot_comes_to_rest_when_its_pad_is_unplugged(pad: VirtualPad) -> None:
    cell = QuietCell("lab", Waits())
    driven = Teleoperator(cell.models["gr"], CYCLE_S, DrivingMode.COUPLED)
    places: list[np.ndarray] = []
    enough = asyncio.Event()
    with Settled(driven) as gamepad:

        def watch(q: np.ndarray) -> None:
            places.append(q)
            if len(places) == 60:  # the pad is found anew on the clock of the cell
                pad.press(MOVE)
                pad.push(StickAxis.RIGHT_Y, -1.0)
            elif len(places) == 100:
                assert abs(places[-1] - places[-2]).max() > 1e-4, "it moves as the device goes"
                pad.pull_out()
            elif len(places) == 160:
                assert driven.is_at_rest
                assert not enough.is_set()
                enough.set()

        async with asyncio.timeout(300):
            await teleoperate(cell, driven, gamepad, ControlStatistics(), watch, enough)
    assert abs(places[-1] - places[-2]).max() < 1e-9
