"""Advisor mode: the computer suggests configurations, the operator chooses one, and the robot goes there."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.advisor import NOT_LOOKED_FOR, Option, Progress
from deltaq_controllers.advisor.session import Answered, near_home
from deltaq_controllers.advisor.time_parameterisation import Route, timed
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.inverse.tracking import ConstraintTracker, TrackingError
from deltaq_controllers.modes.hands import GLIMPSE_S, Hands, kept_while_braked
from deltaq_controllers.modes.interface import Advance, Instant, Limit, Limitation, Motion
from deltaq_controllers.modes.stepped import SteppedMode
from deltaq_controllers.task import NO_TASK, Task
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode

AT_START = 1e-9
"""The robot stands where a path begins within this, in every joint [rad or m]."""

ARRIVED = 1e-9
"""The robot stands at an option within this, in every joint [rad or m]."""

NOTHING_FOUND = (
    "no configuration keeps the hands here clear of limits and obstacles; move the hands and ask again"
)

WOULD_PART = (
    "the path there would separate hands that hold an object; choose grip free first, or another option"
)


def tracker_of(robot: RobotModel, hands_may_leave: bool = False, task: Task = NO_TASK) -> ConstraintTracker:
    """The inverse that the advisor needs.

    Raises:
        ControllerError: the robot has none, or is not redundant and its hand may not leave its place.
    """
    try:
        tracker = ConstraintTracker(robot, task)
    except TrackingError as error:
        raise ControllerError(f"mode advisor: {error}") from None
    if not len(tracker.base) and not hands_may_leave:
        raise ControllerError(
            f"mode advisor needs a redundant robot, {robot.name!r} is not; choose joint, decoupled or coupled, "
            "or let its hand leave its pose"
        )
    return tracker


class Advisor(Protocol):
    """An advisor that answers in the background of a control loop, as `AdvisorProcess` does.

    Attributes:
        tracker: of the robot.
    """

    tracker: ConstraintTracker

    def prepare(self) -> None:
        """Return when it is ready to be asked."""
        ...

    @property
    def trouble(self) -> str:
        """Why the newest question cannot be answered; empty if it can."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether a question has not been answered yet."""
        ...

    @property
    def progress(self) -> Progress | None:
        """The options known so far; None before the first."""
        ...

    def ask(
        self, q: Array, trade_off: tuple[str, str] | None = None, hands_may_leave: bool = False, /
    ) -> None:
        """Start a search from `q` (n,) for options that keep the hands in place, or for those of a trade-off."""
        ...

    def seek(self, back: Array, rank: int, /) -> None:
        """Begin to search for a path to an option, if need be by `back` (P, n) to where options were asked for."""
        ...

    def give_up(self) -> None:
        """End the search; options found so far are kept."""
        ...


class AdvisorMode(SteppedMode):
    """Intelligent assistance (Hooper & Noakes, section III): options are requested as the mode begins.

    The robot goes to the chosen option along a self-motion, in the time that its joints need, and comes to
    rest on that path when the choice is withdrawn. From there it can resume, or go to another option.

    Args:
        robot: the robot.
        cycle_s: its cycle [s].
        advisor: answers in its own time.
        pace: share of the path's own speed at which it is driven.

    Attributes:
        trade_off: names of the two criteria whose front is asked for; None: minima of the energy.
        hands_may_leave: whether the hands may leave their poses on the path to an option, and come back.
    """

    name = DrivingMode.ADVISOR
    drives_hands = False

    def __init__(self, robot: RobotModel, cycle_s: float, advisor: Advisor, pace: float = 1.0) -> None:
        super().__init__(robot)
        self._cycle_s, self._advisor, self._pace = cycle_s, advisor, pace
        self._hands = Hands(advisor.tracker.robot)
        self.drives_joints = np.zeros(robot.n, dtype=np.bool_)
        self._wanted: int | None = None
        self._driven: int | None = None
        self._route: Route | None = None
        self._hands_move = self._hold = False
        self._places: Array = advisor.tracker.hands(robot.home)
        self._trail: Array = robot.home[None]
        self._q: Array = np.full(robot.n, np.nan)
        self._hindrance = ""
        self.trade_off: tuple[str, str] | None = None
        self.hands_may_leave = False

    @property
    def options(self) -> tuple[Option, ...]:
        """The options found so far, best first."""
        progress = self._advisor.progress
        return () if progress is None else progress.options

    @property
    def done(self) -> float:
        """Fraction of the duration of the path to the chosen option that has been driven."""
        return self._route.done if self._route is not None and self._driven == self._wanted else 0.0

    @property
    def begun(self) -> int | None:
        """The option of the present path, or of the path at which the choice was withdrawn."""
        return self._driven

    @property
    def driven(self) -> float:
        """Completed fraction of the duration of that path."""
        return self._route.done if self._route is not None else 0.0

    @property
    def is_at_end(self) -> bool:
        """Whether the robot rests at the end of that path."""
        return self._route is not None and bool(
            np.abs(self._q - self._route.end[: self._robot.n]).max() < ARRIVED
        )

    @property
    def search(self) -> Progress | None:
        """The search's progress; None before there is any."""
        return self._advisor.progress

    @property
    def is_searching(self) -> bool:
        """Whether a question has not been answered yet."""
        return self._advisor.is_busy

    @property
    def status(self) -> str:
        """The advisor's present step, or the robot's progress on its path."""
        if self.arrived_at is not None:
            return f"at option {self.arrived_at}"
        if self._wanted is not None and self._driven == self._wanted:
            return f"{100.0 * self.done:.0f} % of the path to option {self._wanted}"
        progress = self._advisor.progress
        if progress is None:
            return self._advisor.trouble or "thinking"
        if self._advisor.is_busy:
            best = f", best energy {progress.energy:.4f}" if np.isfinite(progress.energy) else ""
            return f"{progress.doing}{best}, {progress.trials} trials"
        ways = sum(option.path is not None for option in progress.options)
        options = len(progress.options)
        return f"{options} option{'' if options == 1 else 's'}, {ways} with a path"

    @property
    def arrived_at(self) -> int | None:
        """The chosen option, once the robot has reached it."""
        return self._driven if self._driven == self._wanted and self.is_at_end else None

    @property
    def awaits_advice(self) -> bool:
        """Whether the option that was chosen is still being looked for, or a path to it."""
        return self._wanted is not None and self._driven != self._wanted and self._advisor.is_busy

    def stand_in(self) -> AdvisorMode:
        """An advisor mode with one option near the robot's home; returns when the advisor itself is ready."""
        self._advisor.prepare()
        tracker = self._advisor.tracker
        answer = Progress("finding paths", 1.0, 0.0, 0, (near_home(tracker),))
        return AdvisorMode(self._robot, self._cycle_s, Answered(tracker, answer))

    def enter(self, q: Array) -> None:
        """Ask for options with the hands at their present poses."""
        super().enter(q)
        self._driven, self._route, self._hindrance = None, None, ""
        self._trail = q[None].copy()
        self._advisor.ask(q, self.trade_off, self.hands_may_leave)

    def forget(self) -> None:
        """At rest: end the search and forget the choice; the results so far are kept."""
        self._advisor.give_up()
        self._wanted = self._driven = self._route = None
        self._hindrance = ""

    def leave(self) -> None:
        """End the advisor; no answer is awaited any more."""
        self._advisor.give_up()

    def choose(self, option: int | None) -> None:
        """Go to the option of a rank, counted from 1; None is rest."""
        self._wanted = option

    def advance(self, instant: Instant, asked: Motion) -> Advance:
        """The increment along the path; none along one that would part hands which hold an object."""
        self._hold = instant.held is not None
        return super().advance(instant, asked)

    def bounded(self, q: Array, motion: Motion) -> Motion:
        """The motion, slowed so that the hands stay even if the gate brakes it; none until a path is known."""
        stands = bool((q == self._q).all())
        self._q = q
        if self._driven != self._wanted:
            if stands:
                self._take_up(q)
            return motion.scaled(0.0)
        if self._hold and self._would_part:
            return motion.scaled(0.0)
        if self._hands_move:
            return motion
        tracker = self._advisor.tracker
        q = tracker.with_tolerances(q, self._places)
        rates = self._step(q, motion, GLIMPSE_S) / GLIMPSE_S
        return motion.scaled(kept_while_braked(self._hands, q, rates, tracker.robot.max_acceleration))

    @property
    def _would_part(self) -> bool:
        """Whether the path moves hands, also within a tolerance."""
        tracker = self._advisor.tracker
        return self._hands_move or tracker.driven < tracker.robot.n

    def step(self, q: Array, motion: Motion, time_s: float) -> Array:
        """The displacement along the path."""
        if not self._hands_move:
            q = self._advisor.tracker.with_tolerances(q, self._places)
        return self._step(q, motion, time_s)[: self._robot.n]

    def _step(self, q: Array, motion: Motion, time_s: float) -> Array:
        if self._route is None or motion.along == 0.0:
            return np.zeros_like(q)
        return self._route.step(q, self._pace * motion.along * time_s / self._cycle_s)

    def limitation(self, _q: Array, _motion: Motion) -> Limitation | None:
        """Why the chosen option cannot be driven to."""
        hindrance = self._hindrance
        if self._driven == self._wanted:
            hindrance = WOULD_PART if self._hold and self._would_part else ""
        return Limitation(Limit.NO_WAY, f"option {self._wanted}", hindrance) if hindrance else None

    def _take_up(self, q: Array) -> None:
        """Take the path to the chosen option if it is known; otherwise start a search for it."""
        self._hindrance = self._advisor.trouble
        options = self.options
        if self._wanted is None or self._hindrance or (not options and self._advisor.is_busy):
            return
        if not 1 <= self._wanted <= len(options):
            if not self._advisor.is_busy:
                self._hindrance = (
                    f"there is no option {self._wanted}; there are {len(options)}"
                    if options
                    else NOTHING_FOUND
                )
            return
        option = options[self._wanted - 1]
        is_start = bool(np.abs(option.start - q).max() < AT_START)
        if is_start and option.path is not None:
            self._advisor.give_up()  # a control loop in motion needs the processor
            tracker = self._advisor.tracker
            self._places = tracker.hands(option.path[0]) if option.places is None else option.places
            setpoints = timed(option.path, tracker, self._cycle_s, option.hands_move, self._places)
            self._trail = np.concatenate([self._back(q)[::-1], option.path])
            self._route, self._driven, self._hands_move = Route(setpoints), self._wanted, option.hands_move
        elif self._advisor.is_busy:
            return
        elif is_start and option.no_path != NOT_LOOKED_FOR:
            self._hindrance = f"no self-motion leads to option {self._wanted}: {option.no_path}"
        else:
            self._advisor.seek(self._back(q), self._wanted)

    def _back(self, q: Array) -> Array:
        """(P, n) the path from `q` (n,), on or near the trail, back to where the trail begins."""
        nearest = int(np.abs(self._trail - q).max(axis=1).argmin())
        return np.concatenate([q[None], self._trail[nearest::-1]])
