"""A zenoh session for asyncio: queries that can be awaited, samples that arrive in the loop."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

import zenoh

from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.in_order import in_order
from deltaq_protocol.messages import Error, Message
from deltaq_protocol.newest import Newest
from deltaq_protocol.served_in_loop import ServedInLoop
from deltaq_protocol.session import declare_publisher, sending
from deltaq_protocol.topic import Topic

Prove = Callable[[str, bytes], bytes]
"""Makes a proof from a zenoh key and a message as it is sent."""

QUERY_DEADLINE_S = 1.0
"""Longer than the server waits for the gate, so that the server's own answer arrives first."""
LOOK_AGAIN_S = 0.01
"""Time between two looks whether somebody has come who can answer."""


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

        While nobody is there who could answer, as in the moments in which a link that was lost is made again, it waits
        for somebody; not with a wildcard for the cell. `prove` makes the proof that goes beside the query.

        Raises:
            RefusedError: the server refused the request.
            ServiceUnreachableError: nobody answered within the deadline.
        """
        key, payload = topic.key(cell, robot=robot), pack(request)
        give_up_s = self._loop.time() + deadline_s
        reply: zenoh.Reply | None = None
        try:
            if "*" not in key:  # zenoh does not tell who would answer to that
                await self._somebody_is_there(key, give_up_s)
            left_s = give_up_s - self._loop.time()
            if left_s > 0.0:
                # once: who took it and did not answer may have carried it out
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
        """Wait until somebody can be asked, or until a time of the loop has come."""
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
            with contextlib.suppress(RuntimeError):  # the loop may have ended: nobody is left to be told
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
        """Send a query from where no loop runs any more, and wait until it was answered or will not be."""
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
