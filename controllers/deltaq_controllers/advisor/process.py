"""The advisor beside a control loop: in a separate process, so that the loop never waits for it.

A thread would not do: the loop needs the interpreter every few milliseconds, and the search has it for longer.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Self

from deltaq_controllers.advisor.advisor import Progress
from deltaq_controllers.advisor.session import AdvisorSession
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.live import cell_model
from deltaq_controllers.task import Task
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Description

_READY = 0
"""Number of the unrequested answer which says that the process has loaded its model of the cell."""


@dataclass(frozen=True)
class _Ask:
    number: int
    q: Array
    others: Mapping[str, Array]
    trade_off: tuple[str, str] | None
    hands_may_leave: bool


@dataclass(frozen=True)
class _Seek:
    number: int
    back: Array
    rank: int
    others: Mapping[str, Array]


@dataclass(frozen=True)
class _GiveUp:
    number: int


@dataclass(frozen=True)
class _Answer:
    """The state of an answer by now, or why there can be none."""

    number: int
    progress: Progress | None = None
    trouble: str = ""
    is_over: bool = False


class _GivenUpError(Exception):
    """The caller no longer waits for the answer."""


class AdvisorProcess:
    """Asks the advisor for self-motions of a robot of a running cell.

    Args:
        description: of the cell, from its HLI.
        tracker: of the robot.
        others: returns where the other robots of the cell are now.

    Attributes:
        tracker: as given.
    """

    def __init__(
        self,
        description: Description,
        tracker: ConstraintTracker,
        others: Callable[[], Mapping[str, Array]],
    ) -> None:
        self.tracker = tracker
        self._others = others
        self._newest = _Answer(_READY, is_over=True)
        self._is_ready = False
        context = multiprocessing.get_context("spawn")
        self._line, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, description, tracker.robot.name, tracker.task), daemon=True
        )
        self._process.start()
        theirs.close()

    def prepare(self) -> None:
        """Wait until the process has loaded its model of the cell; one that has ended is reported as trouble."""
        while not self._is_ready and not self._newest.trouble:
            self._line.poll(None)
            self._listen()

    def ask(self, q: Array, trade_off: tuple[str, str] | None = None, hands_may_leave: bool = False) -> None:
        """Begin to look for options; see `AdvisorSession.ask`."""
        self._newest = _Answer(self._newest.number + 1)
        self._send(_Ask(self._newest.number, q, self._others(), trade_off, hands_may_leave))

    def seek(self, back: Array, rank: int) -> None:
        """Begin to search for a path to an option, if need be by `back` (P, n); see `AdvisorSession.seek`."""
        self._newest = _Answer(self._newest.number + 1, self._newest.progress)
        self._send(_Seek(self._newest.number, back, rank, self._others()))

    def give_up(self) -> None:
        """End the search; the results so far are kept."""
        self._newest = _Answer(self._newest.number + 1, self._newest.progress, is_over=True)
        self._send(_GiveUp(self._newest.number))

    @property
    def is_busy(self) -> bool:
        """Whether a question has not been answered yet."""
        self._listen()
        return not self._newest.is_over

    @property
    def progress(self) -> Progress | None:
        """The results so far; None before there are any."""
        self._listen()
        return self._newest.progress

    @property
    def trouble(self) -> str:
        """Why the newest question cannot be answered; empty if it can."""
        self._listen()
        return self._newest.trouble

    def _send(self, question: _Ask | _Seek | _GiveUp) -> None:
        try:
            self._line.send(question)
        except OSError:
            self._lost()

    def _listen(self) -> None:
        try:
            while self._line.poll():
                answer: _Answer = self._line.recv()
                self._is_ready = True
                if answer.number == self._newest.number:
                    self._newest = answer
        except (OSError, EOFError):
            self._lost()

    def _lost(self) -> None:
        trouble = "the advisor's process has ended; leave this mode, and enter it again to start another one"
        self._newest = _Answer(self._newest.number, self._newest.progress, trouble, is_over=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process, also during a search."""
        self._process.terminate()
        self._process.join()
        self._line.close()


def _serve(
    line: Connection,
    description: Description,
    robot: str,
    task: Task,
) -> None:
    """Answer questions until the pipe is closed; a new one ends the one before."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the loop, which ends this process
    counsel, trouble = _counsel(description, robot, task)
    try:
        line.send(_Answer(_READY, is_over=True))
        while True:
            question = line.recv()
            if isinstance(question, _GiveUp):
                continue
            if counsel is None:
                line.send(_Answer(question.number, trouble=trouble, is_over=True))
                continue
            try:
                _answer(line, counsel, question)
            except _GivenUpError:
                continue
            except DeltaqError as error:
                line.send(_Answer(question.number, trouble=str(error), is_over=True))
    except (EOFError, OSError):
        return


def _counsel(description: Description, robot: str, task: Task) -> tuple[AdvisorSession | None, str]:
    """The advisor, made before the first question, which then need not wait for it; or why it cannot be made."""
    try:
        return AdvisorSession(cell_model(description), robot, task), ""
    except DeltaqError as error:
        return None, str(error)


def _answer(line: Connection, counsel: AdvisorSession, question: _Ask | _Seek) -> None:
    last: Progress | None = None

    def go_on(progress: Progress) -> bool:
        nonlocal last
        last = progress
        line.send(_Answer(question.number, progress))
        if line.poll():
            raise _GivenUpError
        return True

    if isinstance(question, _Ask):
        counsel.ask(question.q, question.others, go_on, question.trade_off, question.hands_may_leave)
    else:
        counsel.seek(question.back, question.rank, question.others, go_on)
    line.send(_Answer(question.number, last, is_over=True))
