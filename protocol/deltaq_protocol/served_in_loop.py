"""Samples of zenoh's threads, served in an event loop: the threads only put them where the loop finds them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

import zenoh

from deltaq_protocol.inbox import ITEMS_A_TURN, ClientInbox

T = TypeVar("T")


class ServedInLoop:
    """Subscribers and queryables of one session, and the inboxes that they fill.

    Args:
        session: an open zenoh session; it is closed by `close`.
        loop: the loop in which everything is served.
    """

    def __init__(self, session: Any, loop: asyncio.AbstractEventLoop) -> None:
        self._session = session
        self._loop = loop
        self._declared: list[Any] = []
        self._inboxes: list[ClientInbox[Any]] = []

    def inbox(self, take: Callable[[T], None], capacity: int, a_turn: int = ITEMS_A_TURN) -> ClientInbox[T]:
        """An inbox whose contents `take` is called with in the loop; of what waits the newest `capacity` are kept."""
        inbox = ClientInbox[T](self._loop, take, capacity, a_turn)
        self._inboxes.append(inbox)
        return inbox

    def subscribe(self, key: str, put: Callable[[zenoh.Sample], None]) -> None:
        """Have zenoh's threads call `put` with the samples of a key."""
        self._declared.append(self._session.declare_subscriber(key, _called(put)))

    def answer(self, key: str, put: Callable[[zenoh.Query], None]) -> None:
        """Have zenoh's threads call `put` with the queries of a key."""
        self._declared.append(self._session.declare_queryable(key, _called(put)))

    def close(self) -> None:
        """Stop listening, then close: a session that closes with callbacks still running can panic."""
        while self._declared:
            self._declared.pop().undeclare()
        for inbox in self._inboxes:
            inbox.close()
        self._session.close()


def _called(put: Callable[[Any], None]) -> Any:
    return zenoh.handlers.Callback(put, indirect=False)
