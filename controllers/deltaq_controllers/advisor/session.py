"""An advisor for one robot, question by question."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import Option, Progress, advise
from deltaq_controllers.advisor.exact import ExactClearance, HandsKept, HandsMoved, Space
from deltaq_controllers.advisor.path_planner import NoPathError, PathPlanner
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.criteria.near_bodies import Clearance
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.task import NO_TASK, Task
from deltaq_protocol.arrays import Array

GoOn = Callable[[Progress], bool]


class AdvisorSession:
    """Finds options that keep the hands, and paths to them, from the robot's present configuration.

    Args:
        cell: model of the cell.
        robot: name of the robot.
        task: what the hands have to do.
        options: how many at most.
        effort: of the search.
        seed: of the search.

    Attributes:
        tracker: of the robot.

    Raises:
        AdvisorError: the robot is unknown.
        TrackingError: its arms have no inverse.
        CriterionError: an unknown criterion.
    """

    def __init__(
        self,
        cell: CellModel,
        robot: str,
        task: Task = NO_TASK,
        *,
        options: int = 5,
        effort: float = 1.0,
        seed: int = 0,
    ) -> None:
        cell = task.seen(cell)
        self.tracker = ConstraintTracker(cell.robots[robot], task)
        self._problem = AdvisorProblem(
            cell,
            robot,
            self.tracker.hands(self.tracker.own.home),
            tracker=self.tracker,
            hands_may_leave=True,
        )
        self._exact = ExactClearance(cell, robot)
        self._count, self._effort = options, effort
        self._generator = np.random.default_rng(seed)
        self._first: tuple[Option, ...] = ()
        self._progress = Progress("searching", 0.0, float("inf"), 0)

    def ask(
        self,
        q: Array,
        others: Mapping[str, Array],
        go_on: GoOn,
        trade_off: tuple[str, str] | None = None,
        hands_may_leave: bool = False,
    ) -> None:
        """Look for options that keep the hands at their present poses.

        Args:
            q: (n,) present configuration.
            others: (n,) configuration of each other robot.
            go_on: called with every step, and with the options as they become known; False ends the search.
            trade_off: names of two criteria; options on their Pareto front replace minima.
            hands_may_leave: whether the hands may leave their poses on the path to an option, and return.

        Raises:
            CriterionError: an unknown criterion.
            AdvisorError: the robot is not redundant, and its hand may not leave its pose.
        """
        self._problem = self._problem.at(self.tracker.hands(q), others, hands_may_leave)
        self._exact.place(others)

        def noted(progress: Progress) -> bool:
            self._progress, self._first = progress, progress.options
            return go_on(progress)

        advise(
            self._problem,
            q,
            generator=self._generator,
            options=self._count,
            effort=self._effort,
            exact=self._exact,
            go_on=noted,
            trade_off=trade_off,
        )

    def seek(self, back: Array, rank: int, others: Mapping[str, Array], go_on: GoOn) -> None:
        """Search for a path to one of the options.

        Args:
            back: (P, n) a path from the present configuration to that of the last `ask`. Without another path, the
                path to the option leads back along it.
            rank: of the option, from 1.
            others: (n,) configuration of each other robot.
            go_on: called with the options at the end, and now and then; False ends the search.
        """
        self._exact.place(others)
        first = self._first[rank - 1]
        tracker, poses = self.tracker, self._problem.poses
        moves = first.hands_move or self._leaves(back[:1])
        space: Space = HandsMoved(tracker.own, tracker.task) if moves else HandsKept(tracker, poses)

        def path(start: Array) -> Array:
            ends = [q if moves else tracker.with_tolerances(q, poses) for q in (start, first.q)]
            robot = tracker.own if moves else tracker.robot
            ways = PathPlanner(robot, space, self._exact, self._generator, ends[0])
            return ways.to(ends[1], lambda: go_on(self._progress))[:, : tracker.driven]

        try:
            try:
                found = path(back[0])
            except NoPathError:
                onwards = path(first.start) if first.path is None else first.path
                found = np.concatenate([back, onwards])
            leaves = first.hands_leave or self._leaves(found)
            option = replace(
                first,
                start=back[0],
                path=found,
                no_path="",
                hands_move=first.hands_move or leaves,
                hands_leave=leaves,
            )
        except NoPathError as error:
            option = replace(first, start=back[0], path=None, no_path=str(error))
        known = list(self._progress.options)
        known[rank - 1] = option
        self._progress = replace(self._progress, options=tuple(known))
        go_on(self._progress)

    def _leaves(self, path: Array) -> bool:
        """Whether the hands leave their place on a path (P, n); they do not where they may not."""
        if not self._problem.hands_may_leave:
            return False
        poses, tracker = self._problem.poses, self.tracker
        hands = (tracker.hands(tracker.with_tolerances(q, poses)) for q in path)
        return any(np.abs((at - poses)[:, :3, 3]).max() > IN_PLACE_M for at in hands)


IN_PLACE_M = 1e-3
"""A hand within this is in its place: self-motions keep it there ten times better [m]."""


# The advisor within the control loop, for virtual time: its search takes no virtual time.


class SynchronousAdvisor:
    """Answers before it returns, the other robots of the cell at home.

    Args:
        session: that answers.

    Attributes:
        tracker: of the robot.
        progress: the results so far; None before the first question.
    """

    trouble = ""
    is_busy = False

    def __init__(self, session: AdvisorSession) -> None:
        self._counsel, self.tracker = session, session.tracker
        self.progress: Progress | None = None

    def prepare(self) -> None:
        """Nothing to prepare: the model of the cell is loaded."""

    def ask(self, q: Array, trade_off: tuple[str, str] | None = None, hands_may_leave: bool = False) -> None:
        """Look for options; see `AdvisorSession.ask`."""
        self._counsel.ask(q, {}, self._take, trade_off, hands_may_leave)

    def seek(self, back: Array, rank: int) -> None:
        """Search for a path to the option of a rank; see `AdvisorSession.seek`."""
        self._counsel.seek(back, rank, {}, self._take)

    def give_up(self) -> None:
        """Nothing to do: the search is synchronous."""

    def _take(self, progress: Progress) -> bool:
        self.progress = progress
        return True


# An advisor whose answer is known already.


class Answered:
    """Gives one prepared answer to every question.

    Args:
        tracker: of the robot.
        progress: the answer.

    Attributes:
        tracker, progress: as given.
        trouble: why there is no path from the robot's configuration.
    """

    is_busy = False

    def __init__(self, tracker: ConstraintTracker, progress: Progress) -> None:
        self.tracker = tracker
        self.progress: Progress | None = progress
        self.trouble = ""

    def prepare(self) -> None:
        """Nothing to prepare."""

    def ask(
        self, _q: Array, _trade_off: tuple[str, str] | None = None, _hands_may_leave: bool = False
    ) -> None:
        """The answer is known already."""

    def seek(self, _back: Array, _rank: int) -> None:
        """No path begins where the robot is."""
        self.trouble = f"{self.tracker.robot.name} has been moved meanwhile; advise again"

    def give_up(self) -> None:
        """Nothing to cancel."""


# An option to practise with.


_NEAR = 0.01
"""Distance of the option from home, in every base joint [rad or m]."""


def near_home(tracker: ConstraintTracker) -> Option:
    """The base joints a little off the robot's home."""
    home = tracker.own.home
    end = home.copy()
    end[tracker.base[tracker.base < tracker.driven]] += _NEAR
    nothing_near = Clearance(room_m=0.0, distance_m=0.0, pair=("", ""))
    return Option.along(np.array([home, end]), nothing_near, hands_move=False)
