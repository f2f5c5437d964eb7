"""A zenoh session of the HLI: messages are taken in zenoh's threads, questions in the loop."""

import asyncio
import logging
import os
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import zenoh

from deltaq_protocol.codec import pack
from deltaq_protocol.envelope import Envelopes
from deltaq_protocol.inbox import ClientInbox, ServedInLoop
from deltaq_protocol.messages import Message
from deltaq_protocol.session import THREADS, declare_publisher, sending
from deltaq_protocol.topic import Topic
from deltaq_services.rate_limit import RateLimit

_log = logging.getLogger(__name__)

# A flood over zenoh waits at its sender's: the thread that reads its session pauses, and that of no other.

_WAIT_S = 0.004
"""Delay of a session for each message beyond the rate [s]."""
_THREADS = "(rx: (worker_threads: 14), net: (worker_threads: 2), acc: (handover: net), app: (handover: net))"


def let_threads_wait() -> None:
    """Make zenoh read sessions in threads of their own; call it before the first session is opened.

    Shared threads would let a session that floods delay all others.
    """
    os.environ.setdefault(THREADS, _THREADS)


class FloodWait:
    """Bounds the rate of messages from unproven senders; zenoh's threads call it, one for each session.

    Args:
        most_s: messages a second of all sessions together that pass without a delay; also the greatest burst.
    """

    def __init__(self, most_s: float) -> None:
        self._rate = RateLimit(most_s)
        self._lock = threading.Lock()

    def one_more(self) -> None:
        """Count a message, and delay the calling thread if messages come too fast."""
        with self._lock:
            is_flood = not self._rate.take(time.monotonic())
        if is_flood:
            time.sleep(_WAIT_S)


_WAITING = 256
"""Queries of one topic that may wait for the loop; at rest there is none."""
_QUERIES_S = 200.0
"""Queries a second of one topic from unproven senders, and as many from all others; only a client that asks more has
to wait.
"""
_QUERIES_A_TURN = 4
"""Of one topic, before the loop turns to others: robots' states do not wait for a flood of questions."""


class HliSession:
    """Publishes, takes messages of all robots and services, and answers queries in an event loop.

    Args:
        session: an open zenoh session; it is closed by `close`.
        cell: name of the cell, for the keys.
        loop: the loop that queries are answered in.
        envelopes: encloses all that is published; None in the open realm.
    """

    def __init__(
        self, session: Any, cell: str, loop: asyncio.AbstractEventLoop, envelopes: Envelopes | None = None
    ) -> None:
        self._session = session
        self._cell = cell
        self._envelopes = envelopes
        self._publishers: dict[tuple[str, ...], Any] = {}
        self._served = ServedInLoop(session, loop)
        self._inboxes: dict[str, ClientInbox[Any]] = {}
        self._first: list[ClientInbox[Any]] = []
        self._failed = 0

    def subscribe(self, topic: Topic, take: Callable[[zenoh.Sample], None]) -> None:
        """Call `take` in zenoh's threads with every sample of a topic, of any robot and service.

        To wake the loop would cost more than to decide. A sample that `take` fails on is logged and lost.
        """

        def taken(sample: zenoh.Sample) -> None:
            try:
                take(sample)
            except Exception:  # no message may end zenoh's thread
                self._failed += 1
                _log.exception("a message could not be served")

        self._served.subscribe(topic.key(self._cell), taken)

    def answer_at_once(self, topic: Topic, take: Callable[[zenoh.Query], None]) -> None:
        """Call `take` in zenoh's thread with every query of a topic; for answers that need no decision."""
        flood = FloodWait(_QUERIES_S)

        def answer(query: zenoh.Query) -> None:
            take(query)
            flood.one_more()

        self._served.answer(topic.key(self._cell), answer)

    def answer(
        self,
        topic: Topic,
        take: Callable[[zenoh.Query], None],
        goes_first: Callable[[zenoh.Query], bool] | None = None,
    ) -> None:
        """Call `take` in the loop with every query of a topic, of any robot.

        Queries for which `goes_first` is true, as asked in zenoh's thread, wait in a queue of their own. A client that
        asks too much has to wait, in either queue, but only after its query was queued: so no stop waits for a flood.
        """
        flood = FloodWait(_QUERIES_S)
        inbox = self._inboxes[topic.name] = self._served.inbox(take, _WAITING, _QUERIES_A_TURN)
        if goes_first is None:
            self._served.answer(topic.key(self._cell), _put_and_wait(inbox, flood))
            return
        first = self._served.inbox(take, _WAITING, _QUERIES_A_TURN)
        self._first.append(first)
        put_first, put = _put_and_wait(first, FloodWait(_QUERIES_S)), _put_and_wait(inbox, flood)

        def put_in_place(query: zenoh.Query) -> None:
            (put_first if goes_first(query) else put)(query)

        self._served.answer(topic.key(self._cell), put_in_place)

    def publish(self, topic: Topic, message: Message, **fields: str) -> None:
        """Publish a message of a topic; `fields` of its key as in `Topic.key`."""
        self._publisher(topic, **fields).put(pack(message))

    def publish_once(self, topic: Topic, message: Message, **fields: str) -> None:
        """Publish a message under a key that was not declared, without keeping a publisher."""
        self._session.put(topic.key(self._cell, **fields), pack(message), **sending(topic.priority))

    def counters(self) -> Counter[str]:
        """Counts of messages that were dropped because they came too fast, and of messages that could not be served."""
        counters = Counter({f"{name}_dropped": inbox.dropped for name, inbox in self._inboxes.items()})
        counters["failed"] = self._failed + sum(
            inbox.failed for inbox in (*self._inboxes.values(), *self._first)
        )
        return counters

    def close(self) -> None:
        """Stop listening, and close the session."""
        self._served.close()

    def _publisher(self, topic: Topic, **fields: str) -> Any:
        known = (topic.name, *fields.values())
        publisher = self._publishers.get(known)
        if publisher is None:
            key = topic.key(self._cell, **fields)
            publisher = self._publishers[known] = declare_publisher(
                self._session, key, self._envelopes, topic.priority
            )
        return publisher


def _put_and_wait(inbox: ClientInbox[zenoh.Query], flood: FloodWait) -> Callable[[zenoh.Query], None]:
    def put(query: zenoh.Query) -> None:
        inbox.put(query)
        flood.one_more()

    return put
