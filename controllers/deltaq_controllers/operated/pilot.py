"""What an operated robot is asked for in each cycle. Pure: times are handed in."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from deltaq_controllers.camera.in_use import CameraInUse
from deltaq_controllers.interface import ControllerError, View
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operated.reach import PlannedReach, ReachPlanner, advisor_of, option_way, search_of
from deltaq_controllers.operated.wishes import REST, Wishes, check_grip, check_trade_off
from deltaq_controllers.operator_input.master import Master
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import (
    DriverReport,
    DriverStage,
    DriverWays,
    DrivingMode,
    Grip,
    OperatorCommand,
    Reach,
    ReachJoints,
    Way,
)
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Outcome, Sight, Verdict, ViewTarget, ViewWish


class Pilot:
    """Turns commands into increments: by the teleoperator, along a path to a pose, or by a camera controller.

    Between two of them the robot comes to rest.

    Args:
        teleoperator: of the robot.
        make_follower: makes the camera controller, or raises `ControllerError` where there can be none.
        make_master: makes the master of that name and scale, or raises `ControllerError`.
        make_planner: makes the planner of paths to poses, or raises `ControllerError` where there can be none.

    Attributes:
        is_following: the camera controller drives.
        wishes: the newest command, with the chosen master and grip.
    """

    def __init__(
        self,
        teleoperator: Teleoperator,
        make_follower: Callable[[], CameraInUse],
        make_master: Callable[[str, float], Master],
        make_planner: Callable[[], ReachPlanner],
    ) -> None:
        self._teleoperator = teleoperator
        self._make_follower, self._make_planner = make_follower, make_planner
        self._planner: ReachPlanner | None = None
        self._why_not: dict[DrivingMode, str] = {}
        self.wishes = Wishes(teleoperator, make_master)
        self._takes_anew = False
        self._q = teleoperator.robot.home
        self._follower: CameraInUse | None = None
        self._view: ViewWish | None = None
        self._reach: PlannedReach | None = None
        self._active: Teleoperator | None = teleoperator
        self._is_still = True
        self._when_still: Callable[[Array], None] | None = None
        self._ways: tuple[object, DriverWays] = (None, DriverWays(mode=DrivingMode.JOINT))
        self._mode = teleoperator.mode
        self.is_following = False
        self._limit = ""

    def prepare(self, mode: DrivingMode) -> None:
        """Prepare a mode, which may take seconds; callable from any thread while no lease is held.

        Raises:
            ControllerError: the robot cannot be driven in it.
        """
        try:
            self._make(mode)
        except DeltaqError as error:
            self._why_not[mode] = str(error)
            raise
        self._why_not.pop(mode, None)

    def _make(self, mode: DrivingMode) -> None:
        if mode is DrivingMode.FOLLOW:
            if self._follower is None:
                follower = self._make_follower()
                follower.take(self._view)
                self._follower = follower
        elif mode is DrivingMode.POSE:
            if self._planner is None:
                planner = self._make_planner()
                planner.practise()
                self._planner = planner
        else:
            self._teleoperator.mode_named(mode)

    def take(self, command: OperatorCommand, now_s: float, cycles: int | None = None) -> None:
        """Follow a command: its mode, axes and grip from the next rest on, its motion until it expires.

        Outputs are for the caller; a command with outputs alone keeps the present motion.

        Args:
            command: to follow.
            now_s: time [s].
            cycles: length of its motion, which then is a step; None: until it expires.

        Raises:
            ControllerError: the mode could not be prepared or does not drive that, the robot has one hand, or the
                mode would separate hands that hold an object; the command is then dropped.
        """
        if (command.mode, command.frame, command.grip) != (None, None, None):
            self._change_mode(command)
        wish = OperatorCommand(command.rates, option=command.option, led=command.led)
        if wish != REST or not command.outputs:
            self._wish(wish, now_s, cycles)

    def _change_mode(self, command: OperatorCommand) -> None:
        mode = command.mode or self._mode
        if mode in self._why_not:
            raise ControllerError(self._why_not[mode])
        grip = command.grip or self.wishes.grip
        check_grip(self._teleoperator, grip, mode)
        self.rest()
        self._mode, self.wishes.grip, self._reach = mode, grip, None
        self._teleoperator.frame = command.frame or self._teleoperator.frame

    def advise(
        self, *, again: bool, trade_off: tuple[str, str] | None = None, hands_may_leave: bool = False
    ) -> None:
        """Search options from the robot's rest position, or end the search and forget the choice.

        Args:
            again: look for options.
            trade_off: names of two criteria whose front is wanted in place of minima.
            hands_may_leave: whether the hands may leave their poses on the path to an option, and come back.

        Raises:
            ControllerError: the advisor does not drive, or these are not two criteria.
        """
        advisor = self._advisor
        if advisor is None or self._active is not self._teleoperator:
            raise ControllerError("the advisor is asked in mode advisor: choose it first")
        check_trade_off(trade_off)
        self.rest()

        def ask(q: Array) -> None:
            advisor.trade_off, advisor.hands_may_leave = trade_off, hands_may_leave
            advisor.enter(q)

        self._when_still = ask if again else lambda _q: advisor.forget()

    def check_reach(self) -> None:
        """Check that a way to a pose may be planned now.

        Raises:
            ControllerError: another mode, or the robot moves.
        """
        if self._mode is not DrivingMode.POSE:
            raise ControllerError("a pose is reached in mode pose: choose it first")
        if not self._is_still:
            raise ControllerError("the robot moves: let it come to rest, and choose the pose then")

    def plan(self, reach: Reach | ReachJoints, q: Array, others: Mapping[str, Array]) -> PlannedReach:
        """Plan the path to a pose or a configuration, in mode pose; callable from any thread.

        Args:
            reach: the pose, or the configuration.
            q: (n,) setpoint at which the robot rests.
            others: (n,) setpoint of each other robot.

        Raises:
            ControllerError: the robot cannot be brought there.
        """
        assert self._planner is not None  # prepared before the mode was changed
        if isinstance(reach, ReachJoints):
            return self._planner.plan_joints(q, others, reach.q)
        return self._planner.plan(q, others, reach.hand, reach.position_m, reach.quaternion_wxyz)

    def take_reach(self, reach: PlannedReach) -> None:
        """Offer a way to a pose.

        Raises:
            ControllerError: another mode, or the robot moves.
        """
        self.check_reach()
        self.rest()
        self._reach = reach

    def _wish(self, wish: OperatorCommand, now_s: float, cycles: int | None) -> None:
        self.rest()
        if self._mode is DrivingMode.FOLLOW:
            if wish != REST:
                raise ControllerError("the camera follows: choose another mode to move the robot by hand")
            return
        if self._mode is DrivingMode.POSE:
            if wish != REST and (self._reach is None or wish != OperatorCommand(option=1)):
                raise ControllerError("in mode pose the robot goes only to a pose that was planned")
        else:
            self.wishes.check(wish, self._mode)
        self.wishes.take(wish, now_s, cycles)

    def rest(self) -> None:
        """Wish for nothing."""
        self.wishes.rest()

    def begin(self) -> None:
        """Begin a lease: drop commands, and redefine the grasp at the present poses."""
        self.rest()
        self._takes_anew = True

    def take_view(self, wish: ViewWish | None) -> None:
        """Set the requested view of the camera follower, once it follows."""
        self._view = wish
        if self._follower is not None:
            self._follower.take(wish)

    def seen(self) -> tuple[Sight | None, ViewTarget | None]:
        """How well the camera sees its target, and the target, while it follows."""
        if not self.is_following or self._follower is None:
            return None, None
        return self._follower.sight, self._follower.target

    def held(self) -> None:
        """Note that the robot is held: after a reset it moves only on a new command."""
        self.begin()
        self.leave()

    def leave(self) -> None:
        """Bring the robot to rest, and end."""
        self.rest()
        if self._mode is DrivingMode.FOLLOW:
            self._mode = self._teleoperator.mode
        self.is_following = False
        self._when_still = None

    def increment(self, view: View, is_still: bool, now_s: float) -> Array | None:
        """The increment for this cycle, (n,) [rad or m]; None if the robot is at rest and stays there.

        Args:
            view: of the cell.
            is_still: whether the setpoint is at rest.
            now_s: time [s].
        """
        self._is_still, self._q = is_still, view.own.q
        if is_still:  # another driver may have moved it: the difference to the last view is no increment
            view = replace(view, own=replace(view.own, dq=np.zeros_like(view.own.q)))
        if self.is_following or self._mode is DrivingMode.FOLLOW:
            return self._following(view, is_still)
        by_pose = self._mode is DrivingMode.POSE
        wanted: Teleoperator | None = self._teleoperator
        if by_pose:
            wanted = None if self._reach is None else self._reach.teleoperator
        if wanted is not self._active:
            if not is_still:
                return None  # without increments the gate's brake brings it to rest
            self._active = wanted
        if wanted is None:
            return None
        mode = DrivingMode.ADVISOR if by_pose else self._mode
        return self._teleoperated(wanted, mode, Grip.FREE if by_pose else self.wishes.grip, view, now_s)

    def _teleoperated(
        self, teleoperator: Teleoperator, mode: DrivingMode, grip: Grip, view: View, now_s: float
    ) -> Array | None:
        is_still = self._is_still
        if self._takes_anew:
            if not is_still:
                return None
            self._takes_anew = False
            teleoperator.let_go()
        if is_still and self._when_still is not None:
            self._when_still(view.own.q_cmd)
            self._when_still = None
        command = self.wishes.command(now_s)
        settled = teleoperator.is_at_rest and (teleoperator.mode, teleoperator.grip) == (mode, grip)
        if command == REST and is_still and settled:
            self._limit = ""
            return None
        teleoperator.command = replace(command, mode=mode, grip=grip)
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
        if self._active is None:
            return
        self._active.take_verdict(verdict)
        if self._active.limitation is not None:
            self._limit = self._active.limitation.text

    def report(self, stage: DriverStage) -> DriverReport:
        """How the robot is driven."""
        distance_m = None if self._follower is None else self._follower.desired_distance_m
        offers = self._offers
        by_pose = self._mode is DrivingMode.POSE
        doing = "" if self.is_following or by_pose else self._teleoperator.status
        master = self.wishes.master
        if master is not None:
            doing = " · ".join(part for part in (doing, f"master, {master.status}") if part)
        return DriverReport(
            stage=stage,
            mode=self._mode,
            frame=self._teleoperator.frame,
            limit=self._limit,
            goes_through=self._goes_through,
            grip=self.wishes.grip,
            hands_off=self.wishes.hands_off(self._q),
            master="" if master is None else master.name,
            master_scale=1.0 if master is None else master.scale,
            doing=doing,
            distance_m=distance_m,
            search=None if offers is None else search_of(offers),
        )

    @property
    def _goes_through(self) -> float:
        """The executed fraction of the command, in tenths, so that it changes seldom."""
        if self._active is None or self.is_following or not self._limit:
            return 1.0
        return round(self._active.reflection.share, 1)

    def ways(self) -> DriverWays:
        """The paths offered now; equal to the previous value if nothing has changed."""
        offers = self._offers
        source: object = None if offers is None else offers.options if self._reach is None else self._reach
        if source is not self._ways[0] or self._ways[1].mode is not self._mode:
            self._ways = source, DriverWays(mode=self._mode, ways=self._offered(offers))
        return self._ways[1]

    def _offered(self, offers: AdvisorMode | None) -> tuple[Way, ...]:
        if self._reach is not None:
            return (self._reach.way,)
        options = () if offers is None else offers.options
        return tuple(option_way(rank, option) for rank, option in enumerate(options, start=1))

    @property
    def _offers(self) -> AdvisorMode | None:
        """The mode that offers ways, if one drives."""
        if self._mode is DrivingMode.POSE:
            return None if self._reach is None else advisor_of(self._reach.teleoperator)
        return self._advisor if self._mode is DrivingMode.ADVISOR else None

    @property
    def _advisor(self) -> AdvisorMode | None:
        return advisor_of(self._teleoperator)

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
