"""Drive a robot of a running cell with a controller: the shell around every controller's core."""

import asyncio
import contextlib
import gc
import logging
import math
import os
import resource
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from deltaq_cell.cell_model import CellModel, robots_told
from deltaq_cell.description import CellDescription
from deltaq_cell.load import parse_cell
from deltaq_cell.robot import RobotModel
from deltaq_controllers.answers import Answers, lease
from deltaq_controllers.interface import Controller, ControllerError, View
from deltaq_controllers.robot_clocks import ClockReading
from deltaq_protocol import log
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Description, Outcome, Sight, Verdict, ViewTarget, ViewWish
from deltaq_protocol.real_time import (
    SchedulingPriority,
    give_processors,
    keep_to_one_processor,
    place_of_robot,
)

# Counts of a controller's run: verdicts, reasons, and errors after the start-up.


class ToolChangedError(ControllerError):
    """A robot has another tool than the models of this process."""


def check_tools(cell: Cell, coupled: Mapping[str, str | None]) -> None:
    """Check that the robots have the tools that they had when their models were made.

    Raises:
        ToolChangedError: one has not.
    """
    if coupled and (now := cell.description.coupled) != coupled:
        changed = next(name for name in now if now[name] != coupled.get(name))
        raise ToolChangedError(f"the tool of {changed} has changed; start again")


class ErrorStatistics:
    """Root mean square, largest and last size of an error."""

    def __init__(self) -> None:
        self._count = 0
        self._squares = 0.0
        self._max = 0.0
        self._final = 0.0

    def add(self, error: float, settled: bool) -> None:
        """Add an error; before the start-up is over it only counts as the last one."""
        self._final = abs(error)
        if settled:
            self._count += 1
            self._squares += error * error
            self._max = max(self._max, abs(error))

    def figures(self, unit: float = 1.0) -> dict[str, float | None]:
        """`rms` and `max`, None while there is nothing after the start-up, and `final`; in parts of `unit`."""
        if not self._count:
            return {"rms": None, "max": None, "final": self._final / unit}
        rms = math.sqrt(self._squares / self._count)
        return {"rms": rms / unit, "max": self._max / unit, "final": self._final / unit}


class ControlStatistics:
    """Cycles, verdicts by outcome, and reasons by code.

    Attributes:
        cycles: increments requested.
        unanswered: increments without a verdict.
    """

    def __init__(self) -> None:
        self.cycles = 0
        self.unanswered = 0
        self._outcomes: Counter[str] = Counter(
            {outcome.value: 0 for outcome in Outcome if outcome is not Outcome.UNKNOWN}
        )
        self._reasons: Counter[str] = Counter()

    def add(self, verdict: Verdict | None) -> None:
        """Count the verdict on an increment; None, or one of outcome `unknown`, if it never came."""
        self.cycles += 1
        if verdict is None or verdict.outcome is Outcome.UNKNOWN:
            self.unanswered += 1
            return
        self._outcomes[verdict.outcome.value] += 1
        self._reasons.update(reason.code.value for reason in verdict.reasons)

    def summary(self) -> dict[str, Any]:
        """The counts as a JSON object."""
        return {
            "cycles": self.cycles,
            "unanswered": self.unanswered,
            "gate": dict(self._outcomes),
            "reasons": dict(self._reasons),
        }


# A control loop's place on shared cores: after the services, and ahead of all ordinary programs.


GREED_S = 0.25
"""A controller that computes for so long without waiting for anything loses its priority: it is no control loop [s]."""

_THREADS = Path("/proc/self/task")


@contextlib.contextmanager
def ahead_of_ordinary_programs(place: int | None = None) -> Iterator[bool]:
    """Run a control loop with real-time priority, where the system allows it.

    All threads that the process has at the beginning take part, those that carry its messages among them. What is
    started within the block, a thread or a process, is ordinary. So is the controller itself from the moment when it
    has computed for `GREED_S` without waiting: it shall not keep the machine from others. Only a loop in the main
    thread asks.

    Args:
        place: of the process among those of its cell, which keeps it to one processor; None for any processor.

    Yields:
        Whether the system allowed it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    processors = os.sched_getaffinity(0)

    def give_back(_signal: int = 0, _frame: FrameType | None = None) -> None:
        _schedule_threads(os.SCHED_OTHER, 0)
        give_processors(processors)

    before = signal.signal(signal.SIGXCPU, give_back)
    resource.setrlimit(resource.RLIMIT_RTTIME, (_greed_us(hard), hard))
    try:
        is_allowed = _schedule_threads(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, SchedulingPriority.CONTROLLER)
        if is_allowed and place is not None:
            keep_to_one_processor(place)
        yield is_allowed
    finally:
        give_back()
        resource.setrlimit(resource.RLIMIT_RTTIME, (soft, hard))
        signal.signal(signal.SIGXCPU, before)


def _greed_us(hard: int) -> int:
    asked = round(GREED_S * 1e6)
    return asked if hard == resource.RLIM_INFINITY else min(asked, hard)


def _schedule_threads(policy: int, priority: int) -> bool:
    """Give all threads of this process a policy; returns whether the system allows it."""
    for thread in [int(entry.name) for entry in _THREADS.iterdir()]:
        try:
            os.sched_setscheduler(thread, policy, os.sched_param(priority))
        except PermissionError:
            return False
        except ProcessLookupError:
            continue  # it has ended meanwhile
    return True


_log = logging.getLogger(__name__)

REFUSED, USAGE, UNREACHABLE = 1, 2, 3
"""Exit statuses: refused, wrong usage, unreachable."""


def robot_models(description: Description) -> dict[str, RobotModel]:
    """Models of all robots of a cell with their present tools, from its HLI's description; no file is needed."""
    return _robots(_parsed(description), description)


def cell_model(description: Description) -> CellModel:
    """Model of a cell, structure included, from its HLI's description."""
    cell = _parsed(description)
    return CellModel.of(cell, _robots(cell, description), description.yaml)


def _parsed(description: Description) -> CellDescription:
    return parse_cell(description.yaml, f"description of cell {description.cell}")


def _robots(cell: CellDescription, description: Description) -> dict[str, RobotModel]:
    robots = robots_told(cell, description.urdf, description.hulls)
    return {name: robot.with_tool(description.coupled.get(name)) for name, robot in robots.items()}


def where_others_are(cell: Cell, robot: str) -> Callable[[], dict[str, Array]]:
    """A function that returns the setpoints (n,) of the other robots of a running cell, after their first states."""

    def places() -> dict[str, Array]:
        states = {name: cell.state(name) for name in cell.robots if name != robot}
        return {name: np.array(state.q_cmd) for name, state in states.items() if state is not None}

    return places


def model_of(models: Mapping[str, RobotModel], name: str) -> RobotModel:
    """The model of a robot.

    Raises:
        ControllerError: the cell has no robot of that name.
    """
    if name not in models:
        raise ControllerError(f"the cell has no robot {name!r}; it has {', '.join(models)}")
    return models[name]


async def drive(
    cell: Cell,
    robot: str,
    controller: Controller,
    statistics: ControlStatistics,
    watch: Callable[[View], None] | None = None,
    seen: Callable[[], tuple[Sight | None, ViewTarget | None]] | None = None,
    wished: Callable[[ViewWish | None], None] | None = None,
    reading: ClockReading | None = None,
    coupled: Mapping[str, str | None] | None = None,
) -> None:
    """Answer every state of a robot with the controller's increment, until cancelled.

    In a cell with a lookahead no verdict is waited for (`deltaq_controllers.answers`). One that does not arrive is
    counted, and the next state is answered as usual.

    Args:
        cell: connection to the cell.
        robot: the robot to move.
        controller: makes the increments.
        statistics: counts the verdicts.
        watch: called with each view.
        seen: returns how well the controller sees its target, and the target; published with each increment.
        wished: called with the view that clients have requested.
        reading: of the robots' clocks; None for one of its own.
        coupled: the tools that the controller presumes, as `Description.coupled`; None: the present ones.

    Raises:
        RefusedError: the lease was not granted, or lost.
        ServiceUnreachableError: the HLI is gone.
        ToolChangedError: a robot has another tool now.
    """
    coupled = cell.description.coupled if coupled is None else coupled
    with control_loop(place_of_robot(cell.robots, robot) if robot in cell.robots else None):
        async with await lease(cell, robot) as leased:
            answers = Answers(cell, leased, reading)
            async for state in leased.states():
                check_tools(cell, coupled)
                if wished is not None:
                    wished(state.view)
                for cycle in await answers.due(state):
                    view = answers.view(state)
                    if watch is not None:
                        watch(view)
                    dq = controller.increment(view)
                    if seen is not None:
                        leased.sight, leased.target = seen()
                    await answers.send(state, cycle, dq)
                for verdict in answers.verdicts():
                    statistics.add(verdict)


@contextlib.contextmanager
def control_loop(place: int | None = None) -> Iterator[None]:
    """Prepare the process for a control loop: exempt present objects from garbage collection, ask for priority.

    Args:
        place: as `ahead_of_ordinary_programs` has it.
    """
    gc.collect()
    gc.freeze()  # later garbage collections skip all present objects
    with ahead_of_ordinary_programs(place):
        yield


def run(
    controller: Coroutine[Any, Any, None], summary: Callable[[], dict[str, Any]], name: str, robot: str
) -> int:
    """Run a controller's process to its end, print one JSON line, and return the exit status.

    Args:
        controller: the coroutine; SIGTERM and SIGINT cancel it, which brings the robot to rest.
        summary: gives the object to print at the end.
        name: of the controller, for what it logs.
        robot: name of the robot that it moves.
    """
    try:
        log.configure(name, robot)
    except log.LogFormatError as error:
        controller.close()
        print(f"error: {error}", file=sys.stderr, flush=True)
        return USAGE
    try:
        asyncio.run(until_told(controller))
    except DeltaqError as error:
        _log.error("%s", error)
        log.say_result(summary())
        if isinstance(error, ServiceUnreachableError):
            return UNREACHABLE
        return REFUSED if isinstance(error, RefusedError) else USAGE
    log.say_result(summary())
    return 0


async def until_told(controller: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine until it ends, or until SIGTERM or SIGINT cancels it."""
    task = asyncio.create_task(controller)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task
