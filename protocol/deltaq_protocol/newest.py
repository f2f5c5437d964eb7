"""The newest value of a stream: a slow reader skips values, nothing queues."""

from __future__ import annotations

import asyncio
import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """The newest value, and a way to await a newer one: in the event loop that puts it, or in any other thread.

    Attributes:
        value: the newest value, None before the first.
        version: how many values there have been.
    """

    def __init__(self) -> None:
        self.value: T | None = None
        self.version = 0
        self._changed = asyncio.Event()
        self._in_threads = threading.Condition()

    def put(self, value: T) -> None:
        """Put a newer value."""
        with self._in_threads:
            self.value = value
            self.version += 1
            self._in_threads.notify_all()
        self._changed.set()
        self._changed.clear()  # present waiters are woken; later ones wait for the next value

    async def after(self, version: int, deadline_s: float) -> T:
        """The newest value, as soon as there is one beyond `version`.

        Raises:
            TimeoutError: none came within the deadline.
        """
        if self.version <= version or self.value is None:
            async with asyncio.timeout(deadline_s):
                await self._changed.wait()
        assert self.value is not None  # the event is only ever set after a value
        return self.value

    def wait_after(self, version: int, deadline_s: float) -> tuple[T, int]:
        """The newest value and its version, as soon as there is one beyond `version`; not for the loop's thread.

        Raises:
            TimeoutError: none came within the deadline.
        """
        with self._in_threads:
            if not self._in_threads.wait_for(lambda: self.version > version, deadline_s):
                raise TimeoutError
            assert self.value is not None  # there is no version without a value
            return self.value, self.version
