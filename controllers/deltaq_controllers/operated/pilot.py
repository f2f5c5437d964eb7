"""What an operated robot is asked for in each cycle. Pure: times are handed in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deltaq_controllers.camera.controllers import FocusController
from deltaq_controllers.interface import ControllerError, View
from deltaq_controllers.modes.motion import HAND_AXES, Frame, ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol import driving
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DriverReport, DriverStage, DrivingMode, Wish
from deltaq_protocol.messages import Outcome, Verdict

_REST = OperatorCommand()


class Pilot:
    """Turns wishes into increments: by the teleoperator, or by a camera controller while it follows.

    Between the two the robot is at rest: neither knows what the other has set out to do.

    Args:
        teleoperator: of the robot.
        make_follower: makes the camera controller, or raises `ControllerError` where there can be none.

    Attributes:
        is_following: the camera controller drives.
    """

    def __init__(self, teleoperator: Teleoperator, make_follower: Callable[[], FocusController]) -> None:
        self._teleoperator = teleoperator
        self._make_follower = make_follower
        self._follower: FocusController | None = None
        self._mode = DrivingMode(teleoperator.mode.value)
        self._wish, self._until_s = _REST, -np.inf
        self.is_following = False
        self._limit = ""

    def prepare(self, mode: DrivingMode) -> None:
        """Make what a mode needs, which may take seconds; any thread may.

        Raises:
            ControllerError: the robot cannot be driven in it.
        """
        if mode is not DrivingMode.FOLLOW:
            self._teleoperator.mode_named(ModeName(mode.value))
        elif self._follower is None:
            self._follower = self._make_follower()

    def change_mode(self, mode: DrivingMode, frame: driving.Axes) -> None:
        """Drive in a mode that was prepared, from the next rest on."""
        self.rest()
        self._mode = mode
        self._teleoperator.frame = Frame(frame)

    def wish(self, wish: Wish, now_s: float) -> None:
        """Wish to move, for as long as a wish lasts.

        Raises:
            ControllerError: the mode does not drive that; nothing is wished for then.
        """
        self.rest()
        command = self._command(wish)
        if self._mode is DrivingMode.FOLLOW:
            if command != _REST:
                raise ControllerError("the camera follows: choose another mode to move the robot by hand")
            return
        self._teleoperator.check(command, ModeName(self._mode.value))
        self._wish, self._until_s = command, now_s + driving.WISH_S

    def rest(self) -> None:
        """Wish for nothing."""
        self._wish, self._until_s = _REST, -np.inf

    def view_at(self, distance_m: float) -> None:
        """Keep this distance from what is looked at [m]; after `prepare`."""
        assert self._follower is not None  # prepared
        self._follower.desired_distance_m = distance_m

    def held(self) -> None:
        """The robot is held: after a reset it moves when it is wished for again, and not before."""
        self.rest()
        if self._mode is DrivingMode.FOLLOW:
            self._mode = DrivingMode(self._teleoperator.mode.value)
        self.is_following = False

    def increment(self, view: View, is_still: bool, now_s: float) -> Array | None:
        """The increment for this cycle, (n,) [rad or m]; None if the robot is at rest and is to stay so.

        Args:
            view: what is seen.
            is_still: the setpoint stands still.
            now_s: time [s].
        """
        if self.is_following or self._mode is DrivingMode.FOLLOW:
            return self._following(view, is_still)
        teleoperator = self._teleoperator
        command = self._wish if now_s < self._until_s else _REST
        mode = ModeName(self._mode.value)
        if command == _REST and is_still and teleoperator.is_at_rest and teleoperator.mode is mode:
            self._limit = ""
            return None
        teleoperator.command = OperatorCommand(command.rates, mode, None, command.option)
        increment = teleoperator.increment(view)
        self._limit = teleoperator.limitation.text if teleoperator.limitation is not None else ""
        return increment

    def take_verdict(self, verdict: Verdict | None) -> None:
        """The verdict on the increment."""
        if self.is_following:
            is_whole = verdict is None or verdict.outcome is Outcome.ADMITTED or not verdict.reasons
            self._limit = (
                "" if is_whole or verdict is None else f"{verdict.outcome}: {verdict.reasons[0].what}"
            )
            return
        self._teleoperator.take_verdict(verdict)
        if self._teleoperator.limitation is not None:
            self._limit = self._teleoperator.limitation.text

    def report(self, stage: DriverStage, longest_cycle_s: float | None = None) -> DriverReport:
        """How the robot is driven."""
        distance_m = None if self._follower is None else self._follower.desired_distance_m
        return DriverReport(
            stage=stage,
            mode=self._mode,
            frame=self._teleoperator.frame.value,
            limit=self._limit,
            doing="" if self.is_following else self._teleoperator.status,
            distance_m=distance_m,
            longest_cycle_s=longest_cycle_s,
        )

    def _following(self, view: View, is_still: bool) -> Array | None:
        wanted = self._mode is DrivingMode.FOLLOW
        if self.is_following and not wanted:
            # without increments the gate's brake brings it to rest
            self.is_following = not is_still
            return None
        if not self.is_following and not is_still:
            return None
        self.is_following = True
        assert self._follower is not None  # prepared before the mode was changed
        return self._follower.increment(view)

    def _command(self, wish: Wish) -> OperatorCommand:
        rates = {}
        if wish.joints:
            names = self._teleoperator.robot.joint_names
            if len(wish.joints) != len(names):
                raise ControllerError(f"joints: the robot has {len(names)}, got {len(wish.joints)} speeds")
            rates = {name: speed for name, speed in zip(names, wish.joints, strict=True) if speed}
        if wish.twist is not None:
            prefix = f"{wish.hand}." if wish.hand else ""
            rates |= {
                f"{prefix}{axis}": rate for axis, rate in zip(HAND_AXES, wish.twist, strict=True) if rate
            }
        return OperatorCommand(rates, option=wish.option)
