"""Managers for an `async with` block, or to be opened and closed by hand where a block is inconvenient."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from typing import Any, TypeVar

T = TypeVar("T")

_open: set[Opening[Any]] = set()
"""Managers that are open, so that they stay open though their users keep only the opened object."""


class Opening(AbstractAsyncContextManager[T]):
    """A context manager with `open` and `close` as well, for notebooks; it opens once.

    Args:
        manager: opens and closes.
    """

    def __init__(self, manager: AbstractAsyncContextManager[T]) -> None:
        self._manager = manager

    async def open(self) -> T:
        """Open, as entering the block does."""
        value = await self._manager.__aenter__()
        _open.add(self)
        return value

    async def close(self) -> None:
        """Close, as leaving the block does; nothing happens if it is not open."""
        await self.__aexit__(None, None, None)

    async def __aenter__(self) -> T:
        return await self.open()

    async def __aexit__(self, *error: Any) -> bool | None:
        if self not in _open:
            return None
        _open.discard(self)
        return await self._manager.__aexit__(*error)
