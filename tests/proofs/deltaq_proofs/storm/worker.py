"""Work that goes on in a thread of its own for the length of a block."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self


class Worker(ABC):
    """Works from the beginning of its block to the end; a context manager.

    Args:
        name: of the thread.

    Attributes:
        ended: set when the block is left.
    """

    def __init__(self, name: str) -> None:
        self.ended = threading.Event()
        self._thread = threading.Thread(target=self.work, name=name)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def work(self) -> None:
        """Work until `ended` is set; called in the thread."""

    def close(self) -> None:
        """End the work, and wait for its end."""
        self.ended.set()
        self._thread.join()
