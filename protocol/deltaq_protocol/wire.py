"""A zenoh session for asyncio: queries that can be awaited, samples that arrive in the loop."""

from __future__ import annotations

import asyncio
import contextlib
import threading
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
_LOOK_AGAIN_S = 0.01
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
        for somebody. `prove` makes the proof that goes beside the query.

        Raises:
            RefusedError: the server refused the request.
            ServiceUnreachableError: nobody answered within the deadline.
        """
        key, payload = topic.key(cell, robot=robot), pack(request)
        give_up_s = self._loop.time() + deadline_s
        while (left_s := give_up_s - self._loop.time()) > 0.0:
            try:
                reply, nobody_was_there = await self._query(topic, key, payload, prove, left_s)
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
            if not nobody_was_there:
                break
            await asyncio.sleep(_LOOK_AGAIN_S)
        raise ServiceUnreachableError(
            f"no answer to {key} within {deadline_s:g} s; is the cell up (`deltaq up`, `deltaq status`)?"
        )

    async def _query(
        self, topic: Topic, key: str, payload: bytes, prove: Prove | None, timeout_s: float
    ) -> tuple[zenoh.Reply | None, bool]:
        """The first reply to a query, None if there is none; and whether nobody was there to be asked."""
        future: asyncio.Future[zenoh.Reply | None] = self._loop.create_future()
        asker, nobody_was_there = threading.get_ident(), False

        def settle(reply: zenoh.Reply | None) -> None:
            if not future.done():
                future.set_result(reply)

        def post(reply: zenoh.Reply | None) -> None:
            with contextlib.suppress(RuntimeError):  # the loop may have ended: nobody is left to be told
                self._loop.call_soon_threadsafe(settle, reply)

        def end() -> None:
            nonlocal nobody_was_there
            # zenoh ends in a thread of its own a query that somebody received, and otherwise at once
            nobody_was_there = threading.get_ident() == asker
            post(None)

        self._session.get(
            key,
            zenoh.handlers.Callback(post, drop=end, indirect=False),
            payload=payload,
            attachment=None if prove is None else prove(key, payload),
            timeout=timeout_s,
            **sending(topic.priority),
        )
        return await future, nobody_was_there

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
