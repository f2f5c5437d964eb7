"""The advisor in the background of a control loop: ask, look now and then, give up at any time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event
from typing import Self

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import Option, Progress, advise
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import Problem
from deltaq_controllers.advisor.space import HandsKept
from deltaq_controllers.advisor.ways import NoWayError, Ways
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.errors import DeltaqError

Array = NDArray[np.float64]


class _GivenUpError(Exception):
    """Nobody waits for the answer any more."""


@dataclass(frozen=True)
class _Models:
    """What every question needs, and takes a moment to make."""

    problem: Problem
    exact: ExactClearance


class Adviser:
    """Asks the advisor for self-motions, in a thread of its own.

    A robot should stand while it is asked: the thread computes, and a control loop beside it answers late.

    Args:
        cell: makes the model of the cell, when it is first needed.
        tracker: of the robot.
        others: where the other robots of the cell are now.
        weights: of the criteria; the advisor's own if not given.
        options: how many at most.
        effort: of the search.
        seed: of the search.
        executor: runs what is asked; a thread if not given.

    Attributes:
        tracker: as given.
        trouble: why what was asked for last cannot be answered; empty if it can.
    """

    def __init__(
        self,
        cell: Callable[[], CellModel],
        tracker: ConstraintTracker,
        others: Callable[[], Mapping[str, Array]] = dict,
        weights: Mapping[str, float] | None = None,
        *,
        options: int = 5,
        effort: float = 1.0,
        seed: int = 0,
        executor: Executor | None = None,
    ) -> None:
        self._cell, self.tracker, self._others, self._weights = cell, tracker, others, weights
        self._count, self._effort, self._generator = options, effort, np.random.default_rng(seed)
        self._executor = executor or ThreadPoolExecutor(1, thread_name_prefix="adviser")
        self._models: _Models | None = None
        self._task: Future[None] | None = None
        self._given_up = Event()
        self._progress: Progress | None = None
        self._first: tuple[Option, ...] = ()
        self.trouble = ""

    @property
    def is_busy(self) -> bool:
        """Whether a question has not been answered yet."""
        return self._task is not None and not self._task.done()

    def ask(self, q: Array) -> None:
        """Begin to look for options that keep the hands where they are at `q` (n,)."""
        self._progress, self.trouble = None, ""
        self._submit(self._advise, q.copy())

    def seek(self, back: Array, rank: int) -> None:
        """Begin to look for a way to the option of a rank.

        Args:
            back: (P, n) a way from where the robot stands to where it stood when options were asked for. If there is no
                other, it leads back along this one.
            rank: from 1.
        """
        self._submit(self._find_way, back.copy(), rank)

    def give_up(self) -> None:
        """End what is going on; what is known stays known."""
        self._given_up.set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Give up for good."""
        self.give_up()
        self._executor.shutdown()

    @property
    def progress(self) -> Progress | None:
        """What is known by now; None before anything is."""
        if self._task is not None and self._task.done():
            self._task.result()
        return self._progress

    def _submit(self, work: Callable[..., None], *arguments: Array | int) -> None:
        self.give_up()
        self._given_up = Event()
        self._task = self._executor.submit(self._until_given_up, work, self._given_up, *arguments)

    def _until_given_up(self, work: Callable[..., None], given_up: Event, *arguments: Array | int) -> None:
        try:
            work(given_up, *arguments)
        except _GivenUpError:
            return
        except DeltaqError as error:
            self.trouble = str(error)

    def _advise(self, given_up: Event, q: Array) -> None:
        models = self._models_at(self.tracker.hands(q))
        models.exact.place(self._others())

        def go_on(progress: Progress) -> bool:
            if given_up.is_set():
                raise _GivenUpError
            self._progress, self._first = progress, progress.options
            return True

        advise(
            models.problem,
            q,
            generator=self._generator,
            options=self._count,
            effort=self._effort,
            exact=models.exact,
            go_on=go_on,
        )

    def _find_way(self, given_up: Event, back: Array, rank: int) -> None:
        models, progress = self._models, self._progress
        assert models is not None  # there are options
        assert progress is not None
        models.exact.place(self._others())
        space = HandsKept(self.tracker, models.problem.poses)
        ways = Ways(models.problem, space, models.exact, self._generator)
        first, known = self._first[rank - 1], list(progress.options)

        def path(start: Array) -> Array:
            return ways.path(start, first.q, go_on=lambda: not given_up.is_set())

        try:
            try:
                found = path(back[0])
            except NoWayError:
                onwards = path(first.start) if first.path is None else first.path
                found = np.concatenate([back, onwards])
            option = replace(first, start=back[0], path=found, no_path="")
        except NoWayError as error:
            option = replace(first, start=back[0], path=None, no_path=str(error))
        if not given_up.is_set():
            known[rank - 1] = option
            self._progress = replace(progress, options=tuple(known))

    def _models_at(self, T_world_hands: Array) -> _Models:
        if self._models is None:
            cell, robot = self._cell(), self.tracker.robot.name
            problem = Problem(cell, robot, T_world_hands, self._weights, self.tracker)
            self._models = _Models(problem, ExactClearance(cell, robot))
        self._models = replace(self._models, problem=self._models.problem.at(T_world_hands))
        return self._models
