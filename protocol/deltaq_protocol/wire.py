"""A zenoh session for asyncio: queries that can be awaited, samples that arrive in the loop."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Generic, TypeVar

import zenoh

from deltaq_protocol import topics
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.inbox import ServedInLoop
from deltaq_protocol.messages import Challenge, ChallengeRequest, Error, Message
from deltaq_protocol.role_prover import RoleProver
from deltaq_protocol.session import declare_publisher, sending
from deltaq_protocol.topic import Topic

Prove = Callable[[str, bytes], bytes]
"""Makes a proof from a zenoh key and a message as it is sent."""

QUERY_DEADLINE_S = 1.0
"""Longer than the server waits for the gate, so that the server's own answer arrives first."""
LOOK_AGAIN_S = 0.01
"""Time between two checks whether a server that can answer has appeared."""


class Wire:
    """Wraps an open session for the running loop.

    Args:
        session: an open zenoh session.
        loop: the loop in which everything is served.
    """

    def __init__(self, session: Any, loop: asyncio.AbstractEventLoop) -> None:
        self._session = session
        self._loop = loop
        self._served = ServedInLoop(session, loop)

    async def ask(
        self,
        topic: Topic,
        cell: str,
        request: Message,
        robot: str = "",
        deadline_s: float = QUERY_DEADLINE_S,
        prove: Prove | None = None,
    ) -> bytes:
        """Send a query and return the payload of its answer; `robot` where the topic's key has one.

        While no server is there, as after a lost link, it waits for one, unless the key has a wildcard for the cell.
        `prove` makes the proof that is attached to the query.

        Raises:
            RefusedError: the server refused the request.
            ServiceUnreachableError: no answer within the deadline.
        """
        key, payload = topic.key(cell, robot=robot), pack(request)
        give_up_s = self._loop.time() + deadline_s
        reply: zenoh.Reply | None = None
        try:
            if "*" not in key:  # zenoh cannot tell whether a key with a wildcard has a server
                await self._somebody_is_there(key, give_up_s)
            left_s = give_up_s - self._loop.time()
            if left_s > 0.0:
                # not repeated: a server that took it without answering may have carried it out
                reply = await self._query(topic, key, payload, prove, left_s)
        except zenoh.ZError as error:
            raise ServiceUnreachableError(
                f"no query to {key}: the connection was closed; connect again"
            ) from error
        if reply is not None and reply.ok is not None:
            return reply.ok.payload.to_bytes()
        if reply is not None and reply.err is not None:
            with contextlib.suppress(InvalidMessageError):  # a timeout of zenoh itself is no reply
                refusal = unpack(Error, reply.err.payload.to_bytes())
                raise RefusedError(refusal.code, refusal.message, refusal.hint)
        raise ServiceUnreachableError(
            f"no answer to {key} within {deadline_s:g} s; is the cell up (`deltaq up`, `deltaq status`)?"
        )

    async def _somebody_is_there(self, key: str, give_up_s: float) -> None:
        """Wait until a server can be asked, or until a time of the loop."""
        querier = self._session.declare_querier(key)
        try:
            while not querier.matching_status.matching and self._loop.time() < give_up_s:
                await asyncio.sleep(LOOK_AGAIN_S)
        finally:
            with contextlib.suppress(zenoh.ZError):  # the session was closed meanwhile
                querier.undeclare()

    async def _query(
        self, topic: Topic, key: str, payload: bytes, prove: Prove | None, timeout_s: float
    ) -> zenoh.Reply | None:
        """The first reply to a query; None if there is none."""
        future: asyncio.Future[zenoh.Reply | None] = self._loop.create_future()

        def settle(reply: zenoh.Reply | None) -> None:
            if not future.done():
                future.set_result(reply)

        def post(reply: zenoh.Reply | None) -> None:
            with contextlib.suppress(RuntimeError):  # the loop may have ended: no caller waits for the answer
                self._loop.call_soon_threadsafe(settle, reply)

        self._session.get(
            key,
            zenoh.handlers.Callback(post, drop=lambda: post(None), indirect=False),
            payload=payload,
            attachment=None if prove is None else prove(key, payload),
            timeout=timeout_s,
            **sending(topic.priority),
        )
        return await future

    def ask_now(self, topic: Topic, cell: str, request: Message, robot: str, prove: Prove) -> None:
        """Send a query without a running event loop, and wait for the answer or the deadline."""
        key, payload = topic.key(cell, robot=robot), pack(request)
        with contextlib.suppress(zenoh.ZError):
            for _ in self._session.get(
                key,
                payload=payload,
                attachment=prove(key, payload),
                timeout=QUERY_DEADLINE_S,
                **sending(topic.priority),
            ):
                pass

    def subscribe(self, key: str, take: Callable[[zenoh.Sample], None], capacity: int) -> None:
        """Call `take` in the loop with the samples of a key; of waiting samples the newest `capacity` are kept."""
        self._served.subscribe(key, self._served.inbox(take, capacity).put)

    def subscribe_newest(self, key: str, newest: Newest[zenoh.Sample, Any]) -> None:
        """Keep the newest sample of a key, without waking the loop if no reader waits."""
        self.subscribe_unqueued(key, in_order(newest.put))

    def subscribe_unqueued(self, key: str, put: Callable[[zenoh.Sample], None]) -> None:
        """Call `put` with the samples of a key, in a thread of zenoh's."""
        self._served.subscribe(key, put)

    def publisher(self, topic: Topic, cell: str, robot: str) -> Any:
        """A publisher of a robot's topic; a session that was closed makes its `put` raise `ZError`."""
        return declare_publisher(self._session, topic.key(cell, robot=robot), priority=topic.priority)

    def close(self) -> None:
        """Stop listening, and close the session."""
        self._served.close()


# The newest value of a stream: a slow reader skips values, nothing queues, and unread values are not decoded.

S = TypeVar("S")
T = TypeVar("T")


class Newest(Generic[S, T]):
    """The newest value, and a way to await a newer one: in the event loop, or in any other thread.

    A sample is decoded when it is read, once. The loop is woken only while somebody in it awaits.

    Args:
        loop: the event loop in which `after` is awaited.
        decode: the value of a sample; None keeps the previous value.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, decode: Callable[[S], T | None]) -> None:
        self._loop = loop
        self._decode = decode
        self._value: T | None = None
        self._version = 0
        self._sample: S | None = None
        self._count = 0
        self._awaiting = 0
        self._is_waking = False
        self._changed = asyncio.Event()
        self._in_threads = threading.Condition()

    def put(self, sample: S) -> None:
        """Put a newer sample; any thread may."""
        with self._in_threads:
            self._sample = sample
            self._count += 1
            self._in_threads.notify_all()
        # a task that begins to wait now reads first, and finds the sample
        if self._awaiting and not self._is_waking:
            self._is_waking = True
            with contextlib.suppress(RuntimeError):  # in a loop that has ended nothing waits
                self._loop.call_soon_threadsafe(self._wake)

    @property
    def value(self) -> T | None:
        """The newest value, None before the first."""
        return self.read()[0]

    def read(self) -> tuple[T | None, int]:
        """The newest value, None before the first, and its version: how many samples there had been with it."""
        with self._in_threads:
            if self._sample is not None:
                sample, self._sample = self._sample, None
                value = self._decode(sample)
                if value is not None:
                    self._value, self._version = value, self._count
            return self._value, self._version

    async def after(self, version: int, deadline_s: float) -> tuple[T, int]:
        """The newest value and its version, as soon as there is one beyond `version`.

        Raises:
            TimeoutError: none came within the deadline.
        """
        self._awaiting += 1
        try:
            value, newest = self.read()
            if value is not None and newest > version:
                return value, newest
            async with asyncio.timeout(deadline_s):
                while value is None or newest <= version:
                    await self._changed.wait()
                    value, newest = self.read()
                return value, newest
        finally:
            self._awaiting -= 1

    def wait_after(self, version: int, deadline_s: float) -> tuple[T, int]:
        """`after` for any thread but the loop's; it waits itself."""
        give_up_s = time.monotonic() + deadline_s
        with self._in_threads:
            while True:
                value, newest = self.read()
                if value is not None and newest > version:
                    return value, newest
                if not self._in_threads.wait(max(0.0, give_up_s - time.monotonic())):
                    raise TimeoutError

    def _wake(self) -> None:
        self._is_waking = False
        self._changed.set()
        self._changed.clear()  # present waiters are woken; later ones wait for the next sample


def in_order(put: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], None]:
    """Forward samples of one stream to `put`, except those overtaken by a newer one of their publisher.

    Zenoh's time stamps show the order; sessions with a datagram link set them. Samples without a stamp come in order.
    """
    newest: zenoh.Timestamp | None = None

    def put_if_newer(sample: zenoh.Sample) -> None:
        nonlocal newest
        published = sample.timestamp
        if published is not None:
            if (
                newest is not None
                and published.get_id() == newest.get_id()
                and published.get_time() < newest.get_time()
            ):
                return
            newest = published
        put(sample)

    return put_if_newer


M = TypeVar("M", bound=Message)


class Asking:
    """Asks the server of a cell; `robot` where the topic's key has one.

    Args:
        wire: to the server.
        cell: name of the cell.
        role: shows the client's role; None if it has none to show.
    """

    def __init__(self, wire: Wire, cell: str, role: RoleProver | None) -> None:
        self._wire = wire
        self._cell = cell
        self._role = role

    async def ask(self, answer: type[M], topic: Topic, request: Message, robot: str = "") -> M:
        """Send a query that needs no role.

        Raises:
            RefusedError: the server refused the request.
            ServiceUnreachableError: no answer in time.
        """
        return unpack(answer, await self._wire.ask(topic, self._cell, request, robot))

    async def ask_with_role(self, answer: type[M], topic: Topic, request: Message, robot: str = "") -> M:
        """Send a query that needs a role.

        The token or identity, if there is one, answers a challenge and is not sent.

        Raises:
            RefusedError: the server refused the request.
            ServiceUnreachableError: no answer in time.
        """
        prove = None
        if self._role is not None:
            challenge = await self.ask(Challenge, topics.CHALLENGE, ChallengeRequest())
            prove = partial(self._role.prove, nonce=bytes.fromhex(challenge.challenge))
        return unpack(answer, await self._wire.ask(topic, self._cell, request, robot, prove=prove))
