"""The shell of an operated robot: requests come in lines, the robot's cycle is answered, reports go out."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping

import numpy as np
from pydantic import ValidationError

from deltaq_controllers.answers import Answers
from deltaq_controllers.interface import ControllerError, RobotView
from deltaq_controllers.live import ToolChangedError, check_tools, where_others_are
from deltaq_controllers.operated.pilot import Pilot
from deltaq_controllers.routines.routine import by_kind
from deltaq_controllers.routines.shell import LiveRoutine
from deltaq_protocol.client import Cell
from deltaq_protocol.driving import (
    REQUESTS,
    Advise,
    ChooseMaster,
    DoRoutine,
    DriverAnswer,
    DriverMessage,
    DriverReport,
    DriverRequest,
    DriverStage,
    DriverWays,
    DrivingMode,
    GiveCommand,
    Reach,
    ReachJoints,
    Release,
    Take,
)
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import Phase, RobotState

REPORT_S = 0.2
"""Time between two reports."""
TOLD_AGAIN_S = 1.0
"""A report that says the same is sent again after this."""
_RESTS_WITHIN_S = 2.0


class OperatedRobot:
    """Drives one robot by requests that come line by line.

    Args:
        cell: connection to the cell.
        robot: its name.
        pilot: makes the increments.
        say: sends a line.
    """

    def __init__(self, cell: Cell, robot: str, pilot: Pilot, say: Callable[[DriverMessage], None]) -> None:
        self._cell, self._robot, self._pilot, self._say = cell, robot, pilot, say
        self._others, self._coupled = where_others_are(cell, robot), cell.description.coupled
        self._told_ways: DriverWays | None = None
        self._wanted: asyncio.Queue[Take | None] = asyncio.Queue()
        self._leased: LeasedRobot | None = None
        self._leaving = asyncio.Event()
        self._release: Release | None = None
        self._is_over = self._is_serving = False
        self._told: tuple[float, DriverReport | None] = (0.0, None)
        self._tasks: set[asyncio.Task[None]] = set()
        self._planning = asyncio.Lock()
        self._routine: LiveRoutine | None = None

    async def listen(self, lines: asyncio.StreamReader) -> None:
        """Take requests until the input ends; then the robot comes to rest and is released."""
        try:
            while line := await lines.readline():
                try:
                    self._take(REQUESTS.validate_json(line))
                except ValidationError as error:
                    self._say(DriverAnswer(id="", done=False, text=f"no request: {error.errors()[0]['msg']}"))
        finally:
            self._is_over = True
            self._leaving.set()
            self._wanted.put_nowait(None)

    async def run(self) -> None:
        """Drive whenever the lease is asked for, until the input ends."""
        reporting = asyncio.ensure_future(self._report())
        try:
            while (take := await self._wanted.get()) is not None and not self._is_over:
                await self._serve(take)
        finally:
            reporting.cancel()

    def _take(self, request: DriverRequest) -> None:
        match request:
            case GiveCommand(id=None):
                with contextlib.suppress(ControllerError):  # the report says in which mode it is driven
                    self._pilot.take(request.command, time.monotonic(), request.cycles)
            case Take():
                self._wanted.put_nowait(request)
            case Release():
                if not self._is_serving and self._wanted.empty():
                    self._say(DriverAnswer(id=request.id, done=True))
                else:
                    self._release = request
                    self._leaving.set()
            case _:
                task = asyncio.ensure_future(self._do(request))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)

    async def _do(
        self, request: GiveCommand | ChooseMaster | Advise | Reach | ReachJoints | DoRoutine
    ) -> None:
        text = ""
        try:
            match request:
                case GiveCommand():
                    self._pilot.take(request.command, time.monotonic(), request.cycles)
                    await self._switch(request.command.outputs)
                case ChooseMaster():
                    await asyncio.to_thread(self._pilot.wishes.choose_master, request.master, request.scale)
                case Advise():
                    self._pilot.advise(
                        again=request.action == "ask",
                        trade_off=request.trade_off,
                        hands_may_leave=request.hands_may_leave,
                    )
                case Reach() | ReachJoints():
                    await self._reach(request)
                case DoRoutine():
                    await self._do_routine(request)
        except DeltaqError as error:
            text = str(error)
        self._say(DriverAnswer(id=request.id or "", done=not text, text=text))

    async def _do_routine(self, request: DoRoutine) -> None:
        running = self._running
        if request.action in ("plan", "run"):
            if running is not None:
                raise ControllerError(f"{running.job.routine} runs already; give it up first")
            asked = (self._cell, request.routine, request.equipment, self._robot, request.first)
            if request.action == "plan":
                way = await (await asyncio.to_thread(LiveRoutine, *asked)).way()
                told = {"ways": (way,), "routine": request.routine, "equipment": request.equipment}
                self._say(self._pilot.ways().model_copy(update=told))
                return
            if self._leased is None:
                raise ControllerError("the robot's lease is not held")
            self._pilot.rest()
            self._routine = await asyncio.to_thread(LiveRoutine, *asked)
        elif running is None:
            raise ControllerError("no routine runs")
        elif request.action == "abort":
            running.run.abort()
        else:
            running.run.pause(request.action == "pause")

    @property
    def _running(self) -> LiveRoutine | None:
        """The routine that drives the robot now."""
        return self._routine if self._routine is not None and self._routine.run.end is None else None

    async def _switch(self, outputs: Mapping[str, bool]) -> None:
        if not outputs:
            return
        if self._leased is None:
            raise ControllerError("the robot's lease is not held")
        await self._leased.io(outputs)

    async def _reach(self, request: Reach | ReachJoints) -> None:
        """Plan at rest, in a thread: states are to be read meanwhile. Of several poses the newest counts."""
        self._pilot.check_reach()
        state = self._cell.state(self._robot)
        if state is None:
            raise ControllerError(f"no state of {self._robot} has come yet")
        async with self._planning:
            planned = await asyncio.to_thread(
                self._pilot.plan, request, np.array(state.q_cmd), self._others()
            )
        self._pilot.take_reach(planned)

    async def _serve(self, take: Take) -> None:
        """Hold the lease until it is given back, or lost."""
        self._is_serving = True
        self._pilot.begin()
        with contextlib.suppress(DeltaqError):  # its law may have been compiled since
            await asyncio.to_thread(self._pilot.prepare, DrivingMode.FOLLOW)
        answered = False
        trouble = ""
        try:
            async with self._cell.lease(self._robot, take.client, take.by_force) as leased:
                self._leased = leased
                self._say(DriverAnswer(id=take.id, done=True))
                answered = True
                await self._drive_until_left(leased)
        except DeltaqError as error:
            trouble = str(error)
            if isinstance(error, ToolChangedError):  # the next driver begins with other models
                self._is_over = True
                self._wanted.put_nowait(None)
        finally:
            self._leased = None
            if (routine := self._running) is not None:
                await routine.close()
        if not answered:
            self._say(DriverAnswer(id=take.id, done=False, text=trouble))
        elif trouble:
            self._say(self._pilot.report(DriverStage.FREE).model_copy(update={"doing": trouble}))
        self._is_serving = False
        if not self._is_over:
            self._leaving.clear()
        if self._release is not None:
            self._say(DriverAnswer(id=self._release.id, done=True))
            self._release = None

    async def _drive_until_left(self, leased: LeasedRobot) -> None:
        driving = asyncio.ensure_future(self._drive(leased))
        leaving = asyncio.ensure_future(self._leaving.wait())
        try:
            await asyncio.wait((driving, leaving), return_when=asyncio.FIRST_COMPLETED)
            if not driving.done():
                # it ends by itself at rest; where no states come, the gate's brake has done it
                await asyncio.wait((driving,), timeout=_RESTS_WITHIN_S)
        finally:
            leaving.cancel()
            if not driving.done():
                driving.cancel()
        if driving.done() and not driving.cancelled():
            driving.result()

    async def _drive(self, leased: LeasedRobot) -> None:
        pilot, before, answers = self._pilot, None, Answers(self._cell, leased)
        async for state in leased.states():
            began_s = time.monotonic()
            cycles = await answers.due(state)
            stood = before is not None and before.q_cmd == state.q_cmd
            before = state
            pilot.take_view(state.view)
            if state.phase is Phase.HELD:
                pilot.held()
            if (routine := self._running) is not None:
                if self._leaving.is_set():
                    routine.run.leave("the robot was released")
                await routine.answer(leased, answers, state, cycles, stood)
                if routine.run.end is not None:
                    await routine.close()
                    pilot.begin()
                continue
            check_tools(self._cell, self._coupled)
            if self._leaving.is_set():
                pilot.leave()
                if stood and _has_nothing_ahead(state, answers.own(state)):
                    return
            for cycle in cycles:
                view = answers.view(state)
                increment = pilot.increment(view, stood and _has_nothing_ahead(state, view.own), began_s)
                leased.sight, leased.target = pilot.seen()
                if increment is not None and state.phase is not Phase.HELD:
                    await answers.send(state, cycle, increment)
            for verdict in answers.verdicts():
                pilot.take_verdict(verdict)

    async def _report(self) -> None:
        while True:
            stage = DriverStage.FREE if self._leased is None else DriverStage.LEASED
            routine = None if self._routine is None else self._routine.progress
            routines = by_kind(self._robot in self._coupled)
            report = self._pilot.report(stage).model_copy(update={"routines": routines, "routine": routine})
            now_s = time.monotonic()
            told_s, told = self._told
            if report != told or now_s - told_s >= TOLD_AGAIN_S:
                self._told = (now_s, report)
                self._say(report)
            ways = self._pilot.ways()
            if ways != self._told_ways:
                self._told_ways = ways
                self._say(ways)
            await asyncio.sleep(REPORT_S)


def _has_nothing_ahead(state: RobotState, own: RobotView) -> bool:
    """Whether no increment in flight moves the robot beyond the setpoint just sent."""
    return state.q_cmd == tuple(own.q_cmd.tolist())
