"""The newest value of a stream: a slow reader skips values, nothing queues, and unread values are not decoded."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

S = TypeVar("S")
T = TypeVar("T")


class Newest(Generic[S, T]):
    """The newest value, and a way to await a newer one: in the event loop, or in any other thread.

    A sample is decoded when it is read, once. The loop is woken only while somebody in it awaits.

    Args:
        loop: in which `after` is awaited.
        decode: the value of a sample; None if it has none: then the value before it stands.
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
        # who begins to await now reads first, and finds the sample
        if self._awaiting and not self._is_waking:
            self._is_waking = True
            with contextlib.suppress(RuntimeError):  # in a loop that has ended nobody awaits
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
