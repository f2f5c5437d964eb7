"""Tells that the gate has said something, to a wait that is machine code."""

from __future__ import annotations

import contextlib
import os


class Arrivals:
    """Messages that have come and have not been read.

    Attributes:
        descriptor: readable while there are any; see eventfd(2). It stays open as long as the process: `one` may still
            be under way when a session is closed.
    """

    def __init__(self) -> None:
        self.descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def one(self) -> None:
        """A message has come; called by any thread."""
        os.eventfd_write(self.descriptor, 1)

    def hear(self) -> None:
        """All that has come until now is about to be read."""
        with contextlib.suppress(BlockingIOError):  # nothing has
            os.eventfd_read(self.descriptor)
