"""One robot in the core: its newest messages, its operator, and the commands that a browser may send."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol import driving
from deltaq_protocol.messages import Phase, ViewTarget, ViewWish
from deltaq_services.console.client import Client
from deltaq_services.console.commands import (
    ALL_HANDS,
    DragPose,
    DriverCommand,
    DryRun,
    Jog,
    PassedOn,
    SetMaster,
    SetMode,
    ViewCommand,
    ViewDistance,
)
from deltaq_services.console.feed import RobotFeed, RobotMotion
from deltaq_services.console.messages import Bound, LeaseView, RobotStatusView, WaysView, phase_words
from deltaq_services.console.seat import Seat

MOST_M_S, MOST_RAD_S = 0.5, 1.5
"""Greatest speeds at which a hand is moved by hand [m/s, rad/s]."""
_TWIST = 6
_OF_DRIVER = (
    "mode",
    "frame",
    "grip",
    "hands_off",
    "master",
    "master_scale",
    "goes_through",
    "search",
    "routines",
    "routine",
)
"""Fields of a driver's report that go to its browser unchanged."""


class RobotSide:
    """One robot.

    Args:
        name: the robot's.
        robot: its description.
        cycle_s: its cycle [s].
        bodies: place of each body in the scene's list, by name.
        others: the other robots of the cell, any of which can lead its hand.

    Attributes:
        feed: its newest messages.
        seat: the session of its operator.
        report: the newest report of its driver; None while there is no driver.
        ways: the paths that its driver offers now.
        outside_holder: the holder of its lease according to the HLI.
        bound: the limiting factor of the newest verdict that was not admitted whole.
    """

    def __init__(
        self,
        name: str,
        robot: RobotDescription,
        cycle_s: float,
        bodies: Mapping[str, int],
        others: tuple[str, ...],
    ) -> None:
        self.name, self._others = name, others
        self.feed = RobotFeed(robot, cycle_s, bodies)
        self.seat = Seat(name)
        self.report: driving.DriverReport | None = None
        self.ways: WaysView | None = None
        self.outside_holder: str | None = None
        self.bound: Bound | None = None
        self.outputs: dict[str, bool] = dict.fromkeys(robot.outputs, False)
        self.inputs: dict[str, bool] = dict.fromkeys(robot.inputs, False)
        self.units = dict(zip(robot.joint_names, robot.units, strict=True))
        self._hands = tuple(robot.hands) or ("tool",)
        self._max_velocity = robot.max_velocity
        self._has_camera = robot.camera is not None

    def wish_of(self, jog: Jog) -> driving.GiveCommand:
        """The command that a jog means.

        Raises:
            ValueError: it does not fit the robot; with field, value and bound.
        """
        if jog.option is not None:
            wish = driving.OperatorCommand(option=jog.option)
        elif jog.led:
            wish = driving.OperatorCommand(led=self._led_hand(jog))
        elif jog.hand:
            wish = driving.OperatorCommand(self._hand_rates(jog))
        else:
            wish = driving.OperatorCommand(self._joint_rates(jog))
        return driving.GiveCommand(command=wish, cycles=jog.cycles)

    def _hand_rates(self, jog: Jog) -> dict[str, float]:
        hand = self._free_hand(jog.hand)
        if len(jog.wish) != _TWIST:
            raise ValueError(f"wish: a twist has {_TWIST} elements, got {len(jog.wish)}")
        for what, bound, part in (("m/s", MOST_M_S, jog.wish[:3]), ("rad/s", MOST_RAD_S, jog.wish[3:])):
            size = float(np.linalg.norm(part))
            if size > bound * (1.0 + 1e-9):
                raise ValueError(f"wish: {size:g} {what} is too fast for a hand; bound {bound:g}")
        axes = (f"{hand}.{axis}" if hand else axis for axis in driving.HAND_AXES)
        return {axis: rate for axis, rate in zip(axes, jog.wish, strict=True) if rate}

    def _joint_rates(self, jog: Jog) -> dict[str, float]:
        if len(jog.wish) != len(self._max_velocity):
            raise ValueError(
                f"wish: {self.name} has {len(self._max_velocity)} joints, got {len(jog.wish)} elements"
            )
        for joint, speed, bound in zip(self.units, jog.wish, self._max_velocity, strict=True):
            if abs(speed) > bound * (1.0 + 1e-9):
                raise ValueError(f"wish: {joint} at {speed:g} {self.units[joint]}/s; bound {bound:g}")
        return {joint: speed for joint, speed in zip(self.units, jog.wish, strict=True) if speed}

    def _led_hand(self, jog: Jog) -> str:
        if any(jog.wish):
            raise ValueError(
                "wish: the master leads the hand, so there is no wish beside it; leave one of them out"
            )
        if self.report is None or not self.report.master:
            raise ValueError(f"led: no master was chosen for {self.name}; it may be {self._may_lead}")
        return self._free_hand(jog.hand or ALL_HANDS)

    @property
    def _may_lead(self) -> str:
        return " or ".join(self._others) or "no robot: there is no other in the cell"

    def _free_hand(self, hand: str) -> str:
        """The hand that is moved, none for all of them; while all hold an object none of them moves alone."""
        if hand == ALL_HANDS:
            return ""
        known = self._hand(hand)
        if known and self.report is not None and self.report.grip == "object":
            raise ValueError(
                f"hand: {hand} cannot move alone, since the hands hold an object: move that, or choose grip free first"
            )
        return known

    def _hand(self, hand: str) -> str:
        """The hand as the driver knows it: a robot with one hand calls it by no name."""
        if hand not in self._hands:
            raise ValueError(f"hand: {self.name} has no hand {hand!r}; it has {', '.join(self._hands)}")
        return hand if len(self._hands) > 1 else ""

    def request_of(self, command: DriverCommand, request: str) -> driving.DriverRequest:
        """The driver's request that a command means.

        Raises:
            ValueError: it does not fit the robot; with field, value and bound.
        """
        if isinstance(command, SetMode):
            if command.mode is driving.DrivingMode.FOLLOW and not self._has_camera:
                raise ValueError(f"mode: {self.name} carries no camera to follow with")
            if command.grip == "object" and len(self._hands) < 2:
                raise ValueError(
                    f"grip: {self.name} has one hand, and an object is held by two or more; it has grip free"
                )
            settings = driving.OperatorCommand(mode=command.mode, frame=command.frame, grip=command.grip)
            return driving.GiveCommand(id=request, command=settings)
        if isinstance(command, PassedOn):
            return self._passed_on(command, request)
        names = tuple(self.outputs)
        if command.index >= len(names):
            raise ValueError(f"index: outputs of {self.name}: {len(names)}, got {command.index}")
        outputs = {names[command.index]: command.value}
        return driving.GiveCommand(id=request, command=driving.OperatorCommand(outputs=outputs))

    def _passed_on(self, command: PassedOn, request: str) -> driving.DriverRequest:
        given = command.model_dump(exclude={"robot", "sent_ms"}) | {"id": request}
        if isinstance(command, SetMaster) and command.master not in ("", *self._others):
            raise ValueError(
                f"master: {command.master!r} cannot lead {self.name}; it may be {self._may_lead}"
            )
        if isinstance(command, DragPose):
            given["hand"] = self._hand(command.hand)
        return driving.REQUESTS.validate_python(given)

    def view_of(self, command: ViewCommand) -> ViewWish:
        """The view for a follower that a command means.

        Raises:
            ValueError: the robot cannot follow, or a target is no other robot.
        """
        if not self._has_camera:
            raise ValueError(f"robot: {self.name} carries no camera")
        if isinstance(command, ViewDistance):
            return ViewWish(distance_m=command.value_m)
        for name in command.targets:
            if name not in self._others:
                raise ValueError(
                    f"targets: {name!r} is not another robot; there are {', '.join(self._others)}"
                )
        return ViewWish(targets=tuple(ViewTarget(leader=name) for name in command.targets))

    def checked(self, command: DryRun) -> tuple[float, ...]:
        """The increment of a dry run.

        Raises:
            ValueError: it does not fit the robot.
        """
        if len(command.dq) != len(self._max_velocity):
            raise ValueError(
                f"dq: {self.name} has {len(self._max_velocity)} joints, got {len(command.dq)} elements"
            )
        return command.dq

    def cannot_move(self, now_s: float) -> str:
        """Why a motion command would have no effect now; empty if it would have one."""
        state = self.feed.state
        if state is None or self.feed.is_stale(now_s):
            return f"no state of {self.name} comes: the picture is old"
        if state.phase in (Phase.OFFLINE, Phase.HELD):
            text, remedy = phase_words(state, is_stale=False)
            return f"{self.name} is {text}. {remedy}".rstrip()
        return ""

    def motion(self, now_s: float) -> RobotMotion:
        """The robot's motion, for the progress of a stop."""
        state = self.feed.state
        if state is None or self.feed.is_stale(now_s):
            return RobotMotion(None)
        return RobotMotion(state.phase, state.reason, self.feed.is_still)

    def view(self, now_s: float) -> RobotStatusView:
        """The robot's status for all browsers; `seen_by` adds to each whether it holds the lease."""
        state, report, seat = self.feed.state, self.report, self.seat
        text, remedy = phase_words(state, self.feed.is_stale(now_s))
        outside = self.outside_holder if self.outside_holder != seat.lease_name else None
        holder = seat.holder.name if seat.holder is not None else outside
        lease = LeaseView(
            holder=holder,
            outside=seat.holder is None and holder is not None,
            wanted_by=seat.wanted_by.name if seat.wanted_by is not None else None,
            text=seat.text,
        )
        said = " · ".join(part for part in (report.doing, report.limit) if part) if report is not None else ""
        if report is not None and report.stage is driving.DriverStage.STARTING:
            said = "the driver starts"
        return RobotStatusView(
            phase=Phase.OFFLINE if state is None else state.phase,
            reason=None if state is None else state.reason,
            text=text,
            remedy=remedy,
            lease=lease,
            driving=said,
            view_distance_m=self._view_distance_m(),
            sight=None if state is None else state.sight,
            targets=() if state is None else _asked_for(state.view),
            looks_at="" if state is None or state.target is None else state.target.words(),
            bound=self.bound,
            outputs=self.outputs,
            inputs=self.inputs,
            coupled=None if state is None else state.coupled,
            **({} if report is None else {name: getattr(report, name) for name in _OF_DRIVER}),
        )

    def _view_distance_m(self) -> float | None:
        """The distance that was asked for last, or that its driver keeps."""
        state = self.feed.state
        if state is not None and state.view is not None and state.view.distance_m is not None:
            return state.view.distance_m
        return None if self.report is None else self.report.distance_m

    def seen_by(self, client: Client, view: RobotStatusView) -> RobotStatusView:
        """The view of the robot for one client."""
        if not self.seat.is_held_by(client):
            return view
        return view.model_copy(update={"lease": view.lease.model_copy(update={"mine": True})})


def _asked_for(view: ViewWish | None) -> tuple[str, ...]:
    """The robots that a camera was asked to look at, the most important first."""
    if view is None:
        return ()
    targets = view.targets or (ViewTarget(leader=view.leader),)
    return tuple(target.leader for target in targets if target.leader is not None)
