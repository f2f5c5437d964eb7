"""An event loop in a separate thread, for callers that have none."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Coroutine, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from typing import Any, TypeVar

from deltaq_protocol.errors import ServiceUnreachableError

T = TypeVar("T")

THREAD_NAME = "deltaq client"


class Background:
    """An event loop in a separate thread."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=THREAD_NAME, daemon=True)
        self._thread.start()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine and return its result; an interrupt cancels it.

        Raises:
            ServiceUnreachableError: the loop has ended.
        """
        if self._loop.is_closed():
            coroutine.close()
            raise ServiceUnreachableError("the connection was closed; connect again")
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def iterate(self, items: AsyncIterator[T]) -> Iterator[T]:
        """The items of an async iterator."""

        async def following() -> T:
            return await anext(items)

        while True:
            yield self.run(following())

    @contextmanager
    def entered(self, manager: AbstractAsyncContextManager[T]) -> Iterator[T]:
        """An async context manager as a plain one."""

        async def enter() -> T:
            return await manager.__aenter__()

        async def leave() -> None:
            # the error of the block stays in the caller's thread: an interrupt thrown into a task would end
            # the loop, and the lease could not be given back
            await manager.__aexit__(None, None, None)

        value = self.run(enter())
        try:
            yield value
        finally:
            if not self._loop.is_closed():
                self.run(leave())

    def close(self) -> None:
        """End the loop and its thread."""

        async def finish() -> None:
            rest = asyncio.all_tasks() - {asyncio.current_task()}
            for task in rest:
                task.cancel()
            await asyncio.gather(*rest, return_exceptions=True)
            await self._loop.shutdown_asyncgens()
            await self._loop.shutdown_default_executor()

        self.run(finish())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
