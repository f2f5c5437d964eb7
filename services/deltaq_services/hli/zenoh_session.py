"""A zenoh session of the HLI: what its threads receive is served in the loop."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from typing import Any

import zenoh

from deltaq_protocol.codec import pack
from deltaq_protocol.inbox import ClientInbox
from deltaq_protocol.messages import Message
from deltaq_protocol.seal import UNSEALED, Seal
from deltaq_protocol.session import declare_publisher, sending
from deltaq_protocol.topic import Topic

_WAITING = 256
"""Samples or queries of one topic that may wait for the loop; at rest there is none."""


class LoopSession:
    """Serves a session in an event loop. zenoh's threads do nothing but put into bounded inboxes.

    Args:
        session: an open zenoh session; it is closed by `close`.
        cell: name of the cell, for the keys.
        loop: the loop that everything is served in.
        seal: put on all that is published.
    """

    def __init__(
        self, session: Any, cell: str, loop: asyncio.AbstractEventLoop, seal: Seal = UNSEALED
    ) -> None:
        self._session = session
        self._cell = cell
        self._loop = loop
        self._seal = seal
        self._publishers: dict[str, Any] = {}
        self._declared: list[Any] = []
        self._inboxes: dict[str, ClientInbox[Any]] = {}

    def subscribe(self, topic: Topic, take: Callable[[zenoh.Sample], None]) -> None:
        """Call `take` in the loop with every sample of a topic, of any robot and service."""
        callback = self._callback(topic, take)
        self._declared.append(self._session.declare_subscriber(topic.key(self._cell), callback))

    def answer(self, topic: Topic, take: Callable[[zenoh.Query], None]) -> None:
        """Call `take` in the loop with every query of a topic, of any robot."""
        callback = self._callback(topic, take)
        self._declared.append(self._session.declare_queryable(topic.key(self._cell), callback))

    def publish(self, topic: Topic, message: Message, **fields: str) -> None:
        """Publish a message of a topic; `fields` of its key as in `Topic.key`."""
        key = topic.key(self._cell, **fields)
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = declare_publisher(
                self._session, key, self._seal, topic.priority
            )
        publisher.put(pack(message))

    def publish_once(self, topic: Topic, message: Message, **fields: str) -> None:
        """Publish a message on a key that is not one of ours, without keeping anything for the next time."""
        self._session.put(topic.key(self._cell, **fields), pack(message), **sending(topic.priority))

    def counters(self) -> Counter[str]:
        """Counts of messages that were dropped because they came too fast, and of those that could not be served."""
        counters = Counter({f"{name}_dropped": inbox.dropped for name, inbox in self._inboxes.items()})
        counters["failed"] = sum(inbox.failed for inbox in self._inboxes.values())
        return counters

    def close(self) -> None:
        """Stop listening, then close: a session that closes with callbacks still running can panic."""
        for declared in self._declared:
            declared.undeclare()
        for inbox in self._inboxes.values():
            inbox.close()
        self._session.close()

    def _callback(self, topic: Topic, take: Callable[[Any], None]) -> Any:
        inbox = self._inboxes[topic.name] = ClientInbox[Any](self._loop, take, _WAITING)
        return zenoh.handlers.Callback(inbox.put, indirect=False)
