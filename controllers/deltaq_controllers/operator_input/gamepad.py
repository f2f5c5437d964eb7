"""A gamepad as an operator's stick, laid out as in the console, by `deltaq_protocol.pad_layout`.

The sticks count only while a shoulder button is held. A pad that is unplugged is rest; plugged in again it goes on.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

from deltaq_controllers.modes.motion import Frame, ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.choices import (
    OutputChoice,
    changed_speed,
    grip_of,
    hand_axis,
    next_hand,
    next_mode,
    other_frame,
)
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.operator_input.keyboard import TURN_RAD_M
from deltaq_controllers.operator_input.pad_device import PadButton, PadDevice, PadState, StickAxis, Trigger
from deltaq_controllers.operator_input.view_distance import AskedViewDistance
from deltaq_protocol.pad_layout import PAD_LAYOUT, VIEW_STEP_M, PadFunction

HELP = (
    "hold the left shoulder button to move, the right one to turn: left stick x and y, right stick z\n"
    "Y next mode, X world/tool, A next hand, B ends; start next output, right trigger on, left trigger off\n"
    "cross up/down: view nearer, farther; left/right: slower, faster, in modes of joints or options the next of them"
)

_AXES = {
    PadButton.LEFT_SHOULDER: {StickAxis.LEFT_Y: "x", StickAxis.LEFT_X: "y", StickAxis.RIGHT_Y: "z"},
    PadButton.RIGHT_SHOULDER: {StickAxis.LEFT_Y: "rx", StickAxis.LEFT_X: "ry", StickAxis.RIGHT_Y: "rz"},
}
"""Axes of the hand that the sticks move while a button is held; a stick pushed ahead or left is positive."""
_NAMES = {control.name: control.function for control in PAD_LAYOUT}
BUTTONS = {button: _NAMES[button.name.lower()] for button in PadButton}
"""What each button does; `PadFunction.ROBOT` and `PadFunction.PICTURE` do nothing here."""
TRIGGERS = {trigger: _NAMES[f"{trigger.name.lower()}_trigger"] for trigger in Trigger}
"""What each trigger does."""
_OPTIONS = 9
_PUSHED = 0.5


class Gamepad(OperatorInput):
    """Commands from a gamepad.

    In a mode that drives joints alone the left stick drives the joint chosen, in advisor mode it goes to the option
    chosen while it is pushed ahead; otherwise the sticks move the hand.

    Args:
        teleoperator: the robot that is driven.
        speed_m_s: hand speed at full deflection to begin with; other rates follow from it.
        view: of the camera that watches the robot; None where none does.

    Attributes:
        joint: the joint that the stick drives.
        option: the advisor's option that it goes to.
        hand: the hand that the sticks move; None for all, `object` for an object that all hold.
        output: the digital output that the triggers switch.
    """

    def __init__(
        self, teleoperator: Teleoperator, speed_m_s: float = 0.1, view: AskedViewDistance | None = None
    ) -> None:
        self._teleoperator, self._view = teleoperator, view
        self._device = PadDevice()
        self._speed_m_s = speed_m_s
        self._held: frozenset[PadButton] = frozenset()
        self._waits_for: tuple[str, ...] = ()
        self.joint = 0
        self.option = 1
        self.hand: str | None = None
        self.output = OutputChoice(teleoperator)

    @property
    def status(self) -> str:
        """The present choice."""
        if not self._device.name:
            return "the gamepad is unplugged: rest"
        if self._waits_for:
            return f"let go of {', '.join(self._waits_for)}: nothing moves until each was at rest; B ends"
        if self._is_advised:
            chosen = f"option {self.option}"
        elif self._is_by_hand:
            chosen = f"hand {self.hand or 'all'}"
        else:
            chosen = f"joint {self._teleoperator.robot.joint_names[self.joint]}"
        if self.output.name:
            chosen += f", output {self.output.name}"
        held = "held" if self._holding else "hold a shoulder button to move"
        seen = f", {self._view.status}" if self._view is not None and self._view.status else ""
        return f"{chosen}, {self._speed_m_s:.3f} m/s{seen}, {held}"

    @property
    def is_clutched(self) -> bool:
        """Whether a shoulder button is held, by which a master leads."""
        return self._holding is not None

    @property
    def _is_advised(self) -> bool:
        return self._teleoperator.mode is ModeName.ADVISOR

    @property
    def _is_by_hand(self) -> bool:
        return self._teleoperator.mode_named(self._teleoperator.mode).drives_hands

    @property
    def _holding(self) -> PadButton | None:
        return next((button for button in _AXES if button in self._held), None)

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command from where sticks and buttons stand at a time [s]; None after a button that ends the drive."""
        state = self._device.look(time_s)
        if state is None:
            self._held = frozenset()
            return OperatorCommand()
        self._held, self._waits_for = state.held, state.waits_for
        mode: ModeName | None = None
        frame: Frame | None = None
        for button in state.pressed:
            match BUTTONS[button]:
                case PadFunction.STOP:
                    return None
                case _ if state.waits_for:
                    continue
                case PadFunction.MODE:
                    mode = next_mode(self._teleoperator)
                case PadFunction.FRAME:
                    frame = other_frame(self._teleoperator)
                case chosen:
                    self._choose(chosen)
        outputs = self.output.switched(TRIGGERS[state.pulled[-1]] is PadFunction.ON) if state.pulled else {}
        grip = grip_of(self._teleoperator, self.hand)
        if self._is_advised:
            goes = self._holding is not None and state.sticks[StickAxis.LEFT_Y] < -_PUSHED
            return OperatorCommand({}, mode, frame, self.option if goes else None, outputs, grip)
        return OperatorCommand(self._rates(state), mode, frame, None, outputs, grip)

    def reflect(self, share: float) -> None:
        """Let the hand feel which fraction of the requested motion goes through: the less, the stronger."""
        self._device.rumble(1.0 - share)

    def _choose(self, function: PadFunction) -> None:
        match function:
            case PadFunction.HAND:
                self.hand = next_hand(self._teleoperator, self.hand)
            case PadFunction.OUTPUT:
                self.output.next()
            case PadFunction.NEARER | PadFunction.FARTHER:
                if self._view is not None:
                    self._view.change(-VIEW_STEP_M if function is PadFunction.NEARER else VIEW_STEP_M)
            case PadFunction.PREVIOUS | PadFunction.NEXT:
                self._step(1 if function is PadFunction.NEXT else -1)

    def _step(self, step: int) -> None:
        """The next of what one chooses among in this mode: options, joints, or the hand's speeds."""
        if self._is_advised:
            self.option = (self.option - 1 + step) % _OPTIONS + 1
        elif self._is_by_hand:
            self._speed_m_s = changed_speed(self._speed_m_s, is_faster=step > 0)
        else:
            self.joint = (self.joint + step) % self._teleoperator.robot.n

    def _rates(self, state: PadState) -> dict[str, float]:
        holding = self._holding
        if holding is None:
            return {}
        if not self._is_by_hand:
            robot = self._teleoperator.robot
            factor = TURN_RAD_M if robot.revolute[self.joint] else 1.0
            return {robot.joint_names[self.joint]: -factor * self._speed_m_s * state.sticks[StickAxis.LEFT_Y]}
        factor = TURN_RAD_M if holding is PadButton.RIGHT_SHOULDER else 1.0
        return {
            hand_axis(self.hand, axis): -factor * self._speed_m_s * state.sticks[stick]
            for stick, axis in _AXES[holding].items()
        }

    def __enter__(self) -> Self:
        """Find the gamepad.

        Raises:
            ControllerError: there is none.
        """
        self._device.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the device back."""
        self._device.__exit__(kind, error, trace)
