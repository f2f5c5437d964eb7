"""A client's subscriptions to a cell: states and verdicts of its robots, decoded only when they are read."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from functools import partial
from typing import TypeVar

import zenoh

from deltaq_protocol import topics
from deltaq_protocol.codec import InvalidMessageError, unpack
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Message, RobotState, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.wire import Newest, Wire

M = TypeVar("M", bound=Message)
StateHolder = Newest[zenoh.Sample, RobotState]

SILENCE_S = 1.0
"""Silence after which a reader of states asks whether the server is still there."""
_VERDICTS_WAITING = 1024


class Subscriptions:
    """States from the beginning, verdicts from the first listener on.

    Args:
        wire: to the server.
        cell: name of the cell.
        robots: names of its robots.
        ask_whether_there: raises if the server is gone.

    Attributes:
        counters: messages of the server that could not be understood.
    """

    def __init__(
        self,
        wire: Wire,
        cell: str,
        robots: Collection[str],
        ask_whether_there: Callable[[], Awaitable[object]],
    ) -> None:
        self.counters: Counter[str] = Counter()
        self._wire = wire
        self._cell = cell
        self._ask_whether_there = ask_whether_there
        self._newest: dict[str, StateHolder] = {name: self._subscribed(name) for name in robots}
        self._listeners: dict[str, set[Callable[[Verdict], None]]] = {}

    def known(self, robot: str) -> str:
        """The name of a robot of the cell.

        Raises:
            RefusedError: the cell has no such robot.
        """
        if robot not in self._newest:
            has = ", ".join(self._newest)
            raise RefusedError(ReasonCode.UNKNOWN_ROBOT, f"the cell has no robot {robot!r}", f"it has {has}")
        return robot

    def newest(self, robot: str) -> StateHolder:
        """The holder of the newest state of a robot, for a reader in any thread."""
        return self._newest[self.known(robot)]

    async def states(self, robot: str) -> AsyncIterator[RobotState]:
        """States of a robot as they come, the newest only; see `Cell.states`."""
        newest = self.newest(robot)
        seen = 0
        while True:
            try:
                state, seen = await newest.after(seen, SILENCE_S)
            except TimeoutError:
                await self._ask_whether_there()  # a robot that is offline is waited for
                continue
            yield state

    async def verdicts(self, robot: str) -> AsyncIterator[Verdict]:
        """Every verdict on the increments of a robot; see `Cell.verdicts`."""
        waiting: asyncio.Queue[Verdict] = asyncio.Queue(_VERDICTS_WAITING)

        def listen(verdict: Verdict) -> None:
            if waiting.full():
                waiting.get_nowait()
            waiting.put_nowait(verdict)

        listeners = self.listeners(robot)
        listeners.add(listen)
        try:
            while True:
                try:
                    async with asyncio.timeout(SILENCE_S):
                        verdict = await waiting.get()
                except TimeoutError:
                    await self._ask_whether_there()
                else:
                    yield verdict
        finally:
            listeners.discard(listen)

    def listeners(self, robot: str) -> set[Callable[[Verdict], None]]:
        """Readers of the verdicts on a robot; the first reader causes the subscription."""
        if self.known(robot) not in self._listeners:
            self._listeners[robot] = set()
            key = topics.VERDICT.key(self._cell, robot=robot)
            self._wire.subscribe(key, partial(self._take_verdict, robot), _VERDICTS_WAITING)
        return self._listeners[robot]

    def _subscribed(self, robot: str) -> StateHolder:
        """The newest state of a robot; older and unread states are not decoded."""

        def state(sample: zenoh.Sample) -> RobotState | None:
            state = self._decoded(RobotState, sample)
            return state if state is not None and state.robot == robot else None

        newest: StateHolder = Newest(asyncio.get_running_loop(), state)
        self._wire.subscribe_newest(topics.STATE.key(self._cell, robot=robot), newest)
        return newest

    def _take_verdict(self, robot: str, sample: zenoh.Sample) -> None:
        listeners = self._listeners[robot]
        if not listeners:
            return
        verdict = self._decoded(Verdict, sample)
        if verdict is not None and verdict.robot == robot:
            for listener in tuple(listeners):
                listener(verdict)

    def _decoded(self, message_type: type[M], sample: zenoh.Sample) -> M | None:
        try:
            return unpack(message_type, sample.payload.to_bytes())
        except InvalidMessageError:
            self.counters["malformed"] += 1
            return None
