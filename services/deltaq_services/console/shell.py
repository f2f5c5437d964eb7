"""The console's process: the clock, the ticks, and the core's outputs."""

import asyncio
import contextlib
import logging
import math
import secrets
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from starlette.websockets import WebSocket, WebSocketDisconnect

from deltaq_cell.cell_model import CellModel
from deltaq_cell.identity import content_identity
from deltaq_protocol import driving, topics
from deltaq_protocol.codec import InvalidMessageError, unpack
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.heartbeat import Heartbeat
from deltaq_protocol.identity import CellIdentity, mismatch
from deltaq_protocol.messages import (
    DescribeRequest,
    Done,
    DryRunReply,
    DryRunRequest,
    IoReply,
    IoRequest,
    Message,
    Proximity,
    ResetRequest,
    RobotState,
    Status,
    StopRequest,
    Verdict,
    ViewReply,
    ViewRequest,
)
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_protocol.role_prover import role_prover
from deltaq_protocol.wire import Asking
from deltaq_services.console.client import Client
from deltaq_services.console.commands import id_in
from deltaq_services.console.core import ConsoleCore
from deltaq_services.console.driver_process import DriverProcess
from deltaq_services.console.hli_link import HliLink
from deltaq_services.console.messages import Ack, AckOutcome, StopPhase
from deltaq_services.console.outputs import AskHli, ConsoleOutput, ToClient, ToDriver, ToRecorder
from deltaq_services.console.recordings import RecorderProcess, RecordingFolder, ReplayReader
from deltaq_services.console.scene import BrowserScene, scene_of
from deltaq_services.console.settings import Settings
from deltaq_services.containment import Containment
from deltaq_services.video_stream import video_socket, video_streams

M = TypeVar("M", bound=Message)

_log = logging.getLogger(__name__)

FRAME_S = 0.04
"""Time between two frames: 25 a second."""
_ALONE_S = 0.5
"""Time between two polls of the cell while no browser is connected."""
_TOLD_EVERY = 5
"""Number of frames between two checks for other messages to browsers."""
_POLL_S = 0.5
_NO_ANSWER_S = 5.0
"""Longer than a query takes to fail by itself."""
_STOP_AGAIN_S, _CONFIRMED_S = 0.1, 1.0

_MOST_WAITING = 1000
_TOO_SLOW = 1013
_NOT_TEXT = 1007
"""Of WebSocket: a text that is not UTF-8, after which the server has ended the connection."""


class BrowserConnection:
    """One browser's WebSocket: its messages go to the core, and a slow browser delays no other.

    Only the newest frame waits to be sent. A browser that does not take its messages is disconnected.

    Args:
        websocket: accepted.
    """

    def __init__(self, websocket: WebSocket) -> None:
        self._websocket = websocket
        self._texts: deque[str] = deque()
        self._frame: bytes | None = None
        self._something = asyncio.Event()

    def put_text(self, text: str) -> None:
        """Send a message, after the messages that wait."""
        self._texts.append(text)
        self._something.set()

    def put_frame(self, frame: bytes) -> None:
        """Send a frame, and drop a frame that still waits."""
        self._frame = frame
        self._something.set()

    async def serve(self, take: Callable[[str | bytes], None]) -> None:
        """Pass on the browser's messages, until it disconnects or stops taking messages."""
        receiving = asyncio.ensure_future(self._receive(take))
        sending = asyncio.ensure_future(self._send())
        try:
            await asyncio.wait((receiving, sending), return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (receiving, sending):
                task.cancel()
            await asyncio.gather(receiving, sending, return_exceptions=True)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it has gone already
                await self._websocket.close(_TOO_SLOW if len(self._texts) > _MOST_WAITING else 1000)

    async def _receive(self, take: Callable[[str | bytes], None]) -> None:
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                if message.get("code") == _NOT_TEXT:
                    take(b"")  # counted as every malformed message is
                return
            text = message.get("text")
            take(text if text is not None else message.get("bytes") or b"")

    async def _send(self) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while len(self._texts) <= _MOST_WAITING:
                await self._something.wait()
                self._something.clear()
                while self._texts:
                    await self._websocket.send_text(self._texts.popleft())
                if self._frame is not None:
                    frame, self._frame = self._frame, None
                    await self._websocket.send_bytes(frame)


class Console:
    """The running console of one cell.

    Args:
        cell: the cell's model.
        settings: its settings.

    Attributes:
        scene: the scene for browsers.
        core: makes the decisions.
        folder: of the recordings.
        reader: reads them for browsers.
        epoch_s: how far its clock is ahead of the monotonic one [s].
        pictures: sockets of the live pictures, by name.
    """

    def __init__(self, cell: CellModel, settings: Settings) -> None:
        description, folder = cell.description, settings.recordings
        self.folder = None if folder is None else RecordingFolder(folder)
        self.reader = ReplayReader(str(cell.identity))
        self._recorder = RecorderProcess(settings.cell, self._recorder_began, self._recorder_ended)
        self.scene: BrowserScene = scene_of(cell, settings.emulated)
        self.core = ConsoleCore(
            description,
            self.scene.bodies,
            settings.token_needed,
            has_recordings=folder is not None,
            process=secrets.token_hex(8),
            name=settings.cell,
        )
        self._identity = content_identity(description)
        self._link = HliLink(
            description.hli,
            description.cell,
            tuple(description.robots),
            role_prover(settings.operator_token, None),
        )
        self._signalling = [
            name for name, robot in description.robots.items() if robot.outputs or robot.inputs
        ]
        self._connections: dict[int, BrowserConnection] = {}
        self._drivers = {
            robot: DriverProcess(
                description.hli,
                robot,
                partial(self._driver_said, robot),
                partial(self._driver_ended, robot),
                settings.operator_token,
            )
            for robot in description.robots
        }
        self._tasks: set[asyncio.Task[None]] = set()
        self._newest_stop = ""
        self._heartbeat = Heartbeat()
        self._containment = Containment()
        self.epoch_s = time.time() - time.monotonic()
        self.pictures = {one.name: video_socket(description, one.name) for one in video_streams(description)}

    async def run(self) -> None:
        """Watch the cell until cancelled; then drivers bring their robots to rest."""
        async with self._link:
            polling = asyncio.ensure_future(self._poll())
            try:
                await self._tick()
            finally:
                polling.cancel()
                self._heartbeat.close()
                # a recording goes on until the robots rest
                await asyncio.gather(*(driver.end() for driver in self._drivers.values()))
                await self._recorder.end()

    def now_s(self) -> float:
        """Time of day as it was at the start, and counted on without steps [s]."""
        return self.epoch_s + time.monotonic()

    async def serve(
        self,
        connection: BrowserConnection,
        name: str,
        is_operator: bool,
        address: str,
        session: str = "",
        page: str = "",
    ) -> None:
        """Serve one browser until it disconnects."""
        client, outputs = self.core.connect(name, is_operator, self.now_s(), address, session, page)
        if client is None:
            return
        self._connections[client.number] = connection
        self._carry_out(outputs)
        try:
            await connection.serve(partial(self._take, client))
        finally:
            if self._connections.get(client.number) is connection:  # the page has no newer one
                del self._connections[client.number]
                self._carry_out(self.core.disconnect(client, self.now_s()))

    def _take(self, client: Client, message: str | bytes) -> None:
        before = self.core.stop.phase
        try:
            self._carry_out(self.core.take(client, message, self.now_s()))
        except Exception as error:  # the browser stays connected; the motion that it asked for ends by itself
            self._failed(error)
            text = EXPLANATIONS[ReasonCode.INTERNAL_ERROR]
            refused = Ack(id=id_in(message), outcome=AckOutcome.REFUSED, text=text)
            self._carry_out([ToClient(client.number, refused)])
        if self.core.stop.phase is not before:
            self._carry_out(self.core.tick(self.now_s()))

    def _failed(self, error: Exception) -> None:
        """Count an unexpected error, and log it once."""
        self.core.counters["internal_errors"] += 1
        self._containment.note(error)
        self._containment.log_once(_log)

    def _carry_out(self, outputs: list[ConsoleOutput]) -> None:
        for output in outputs:
            if isinstance(output, AskHli):
                task = asyncio.ensure_future(self._ask(output))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
            elif isinstance(output, ToDriver):
                self._drivers[output.robot].send(output.request)
            elif isinstance(output, ToRecorder):
                self._record(output)
            elif (connection := self._connections.get(output.client)) is not None:
                connection.put_text(output.message.model_dump_json())

    def _record(self, wanted: ToRecorder) -> None:
        if wanted.file is None:
            self._recorder.stop()
        else:
            assert self.folder is not None  # the core has none to record without one
            self._recorder.start(self.folder.path / wanted.file)

    def _recorder_began(self) -> None:
        self.core.desk.began(self.now_s())

    def _recorder_ended(self, why: str) -> None:
        self.core.recorder_ended(why, self.now_s())

    async def _ask(self, asked: AskHli) -> None:
        verdict: Verdict | None = None
        done, text = True, ""
        try:
            verdict = await self._answer(asked, await self._link.asking())
        except DeltaqError as error:
            done, text = False, str(error)
        self._carry_out(self.core.answered(asked.request, done, text, self.now_s(), verdict))
        if asked.kind == "stop":
            self._carry_out(self.core.tick(self.now_s()))

    async def _answer(self, asked: AskHli, asking: Asking) -> Verdict | None:
        """Ask the HLI; a dry run has a verdict."""
        match asked.kind:
            case "stop":
                await self._ask_to_stop(asking, asked.request, asked.client)
            case "reset":
                reset = ResetRequest(robot=asked.robot, client=asked.client)
                await asking.ask_with_role(Done, topics.RESET, reset)
            case "view":
                view = ViewRequest(robot=asked.robot, client=asked.client, **dict(asked.view))
                await asking.ask_with_role(ViewReply, topics.VIEW, view, asked.robot)
            case "dry_run":
                run = DryRunRequest(robot=asked.robot, dq=asked.dq)
                return (await asking.ask(DryRunReply, topics.DRY_RUN, run, asked.robot)).verdict
        return None

    async def _ask_to_stop(self, asking: Asking, request: str, client: str) -> None:
        """Ask for a stop until the HLI answers, or until a later stop takes its place."""
        self._newest_stop, late_s = request, self.now_s() + _CONFIRMED_S
        while True:
            try:
                await asking.ask(Done, topics.STOP, StopRequest(client=client))
                return
            except ServiceUnreachableError as error:
                if self._newest_stop != request or self.core.stop.phase is StopPhase.NONE:
                    raise
                if self.now_s() > late_s:
                    self.core.unconfirmed(str(error), self.now_s())
                    late_s = math.inf  # told once
            await asyncio.sleep(_STOP_AGAIN_S)

    def _driver_said(self, robot: str, said: driving.DriverMessage) -> None:
        self._carry_out(self.core.driver_said(robot, said, self.now_s()))

    def _driver_ended(self, robot: str, why: str) -> None:
        self._carry_out(self.core.driver_ended(robot, why, self.now_s()))

    async def _tick(self) -> None:
        next_s, ticks = time.monotonic(), 0
        while True:
            try:
                self._show(self.now_s(), ticks)
            except Exception as error:  # the next tick may do better: an operator looks on
                self._failed(error)
            ticks += 1
            # missed ticks are not repeated
            next_s = max(next_s + (FRAME_S if self._connections else _ALONE_S), time.monotonic())
            await asyncio.sleep(next_s - time.monotonic())

    def _show(self, now_s: float, ticks: int) -> None:
        """Send the browsers all changes."""
        self._hear(now_s)
        if self._connections:
            frame = self.core.picture.frame(now_s)
            for connection in self._connections.values():
                connection.put_frame(frame)
        stopping = self.core.stop.phase in (StopPhase.ASKED, StopPhase.STOPPING)
        if stopping or not self._connections or ticks % _TOLD_EVERY == 0:
            self._carry_out(self.core.tick(now_s))
        if self._heartbeat.is_due(now_s):
            health = self.core.health()
            self._heartbeat.beat(now_s, bool(health["healthy"]), str(health["detail"]))

    def _hear(self, now_s: float) -> None:
        picture = self.core.picture
        for robot, side in self.core.robots.items():
            heard = self._link.heard(robot)
            arrived_s = self.epoch_s + heard.state_s
            if heard.states:
                side.feed.arrived(heard.longest_gap_s, now_s)
            for payload in heard.states:
                self._understand(RobotState, payload, partial(picture.take_state, arrived_s=arrived_s))
            for payload in heard.verdicts:
                self._understand(Verdict, payload, partial(picture.take_verdict, arrived_s=now_s))
        near = self._link.proximity()
        if near is not None:
            self._understand(Proximity, near, picture.take_proximity)

    def _understand(self, message_type: type[M], payload: bytes, take: Callable[[M], object]) -> None:
        try:
            take(unpack(message_type, payload))
        except InvalidMessageError:
            self.core.counters["malformed_heard"] += 1
        except Exception as error:  # as if it had been lost
            self._failed(error)

    async def _poll(self) -> None:
        """Poll the HLI for all that it does not publish; errors do not end this."""
        while True:
            try:
                async with asyncio.timeout(_NO_ANSWER_S):
                    await self._look()
            except DeltaqError as error:
                self.core.board.silent(str(error), self.now_s())
            except TimeoutError:
                self.core.board.silent(f"no answer within {_NO_ANSWER_S:g} s", self.now_s())
            except Exception as error:
                # an unexpected error is logged in full, and the next poll may succeed: an operator is watching
                _log.exception("the HLI could not be asked")
                self.core.board.silent(repr(error), self.now_s())
            await asyncio.sleep(_POLL_S)

    async def _look(self) -> None:
        """Ask for the lease holders and the digital signals."""
        asking = await self._link.asking()
        status = await asking.ask(Status, topics.STATUS, DescribeRequest())
        theirs = CellIdentity.parse(status.identity)
        if not self._identity.is_same(theirs):
            raise RefusedError("cell_mismatch", mismatch("the HLI", theirs, self._identity))
        for robot in self._signalling:
            io = await asking.ask(IoReply, topics.IO, IoRequest(robot=robot), robot)
            self.core.signals(robot, io.outputs, io.inputs)
        holders = {name: robot.lease.holder for name, robot in status.robots.items()}
        self.core.board.heard(holders, self.now_s())
