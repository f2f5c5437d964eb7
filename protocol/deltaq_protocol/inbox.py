"""From zenoh's threads to the event loop, bounded."""

import asyncio
import contextlib
import ctypes
import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import zenoh

T = TypeVar("T")

_log = logging.getLogger(__name__)

ITEMS_A_TURN = 32
"""Items taken before the loop turns to other work, so that one flood does not starve the rest."""


class ClientInbox(Generic[T]):
    """Items put by any thread and taken by the loop, in order; when it is full the oldest is dropped.

    Args:
        loop: the loop that takes them.
        take: called in the loop, once for each item.
        capacity: how many may wait; with 1 only the newest does.
        a_turn: how many are taken before the loop turns to other work.

    Attributes:
        dropped: how many were dropped.
        failed: how many made `take` fail; the failure is logged, and the next item is taken.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        take: Callable[[T], None],
        capacity: int,
        a_turn: int = ITEMS_A_TURN,
    ) -> None:
        self._loop = loop
        self._take = take
        self._a_turn = a_turn
        self._items: deque[T] = deque(maxlen=capacity)
        self._is_scheduled = False
        self._is_open = True
        self.dropped = 0
        self.failed = 0

    def put(self, item: T) -> None:
        """Put an item; any thread may."""
        if not self._is_open:
            return
        if len(self._items) == self._items.maxlen:
            self.dropped += 1
        self._items.append(item)
        # True here means that the scheduled turn has not begun: it will see the item
        if not self._is_scheduled:
            self._is_scheduled = True
            # the loop has ended: nothing will take the message
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._turn)

    def close(self) -> None:
        """Take no more items, not even waiting ones."""
        self._is_open = False
        self._items.clear()

    def _turn(self) -> None:
        self._is_scheduled = False
        for _ in range(self._a_turn):
            if not self._items or not self._is_open:
                return
            item = self._items.popleft()
            try:
                self._take(item)
            except Exception:  # no message may end the process
                self.failed += 1
                _log.exception("a message could not be served")
        if not self._is_scheduled:
            self._is_scheduled = True
            self._loop.call_soon(self._turn)


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
        """An inbox; the loop calls `take` with each entry. At most the newest `capacity` entries wait."""
        inbox = ClientInbox[T](self._loop, take, capacity, a_turn)
        self._inboxes.append(inbox)
        return inbox

    def subscribe(self, key: str, put: Callable[[zenoh.Sample], None]) -> None:
        """Have zenoh's threads call `put` with the samples of a key."""
        self._declared.append(self._session.declare_subscriber(key, called_in_zenohs_threads(put)))

    def answer(self, key: str, put: Callable[[zenoh.Query], None]) -> None:
        """Have zenoh's threads call `put` with the queries of a key."""
        self._declared.append(self._session.declare_queryable(key, called_in_zenohs_threads(put)))

    def close(self) -> None:
        """Stop listening, then close: a session that closes with callbacks still running can panic."""
        while self._declared:
            self._declared.pop().undeclare()
        for inbox in self._inboxes:
            inbox.close()
        self._session.close()


_known = threading.local()


def called_in_zenohs_threads(put: Callable[[Any], None]) -> Any:
    """A handler that calls `put` in the thread in which zenoh read the message.

    In a thread that Python did not start, each call makes a thread state and maps memory for its stack, and its end
    unmaps it. So the first call in a thread keeps the state: that saves three system calls and two page faults a
    message.
    """

    def called(item: Any) -> None:
        if not hasattr(_known, "state"):
            _known.state = ctypes.pythonapi.PyGILState_Ensure()  # never released
        put(item)

    return zenoh.handlers.Callback(called, indirect=False)
