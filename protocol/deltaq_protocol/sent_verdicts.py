"""The verdicts on increments that a client sent without waiting, until it reads them."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque

from deltaq_protocol.messages import Verdict

_MOST = 1024
"""Largest number of sent increments, and of received verdicts, that are kept unread."""


class SentVerdicts:
    """Keeps the newest verdicts on increments that were sent. Each operation is atomic with respect to other threads.

    Attributes:
        queue: the verdicts that were not read yet.
    """

    def __init__(self) -> None:
        self._sent: deque[int] = deque(maxlen=_MOST)
        self.queue: asyncio.Queue[Verdict] = asyncio.Queue(_MOST)

    def expect(self, seq: int) -> None:
        """An increment is about to be sent."""
        self._sent.append(seq)

    def take(self, verdict: Verdict) -> None:
        """A verdict has come, on what was sent or on something else."""
        if verdict.seq not in self._sent:
            return
        if self.queue.full():
            with contextlib.suppress(asyncio.QueueEmpty):  # a reader in another thread was quicker
                self.queue.get_nowait()
        self.queue.put_nowait(verdict)

    def read(self) -> list[Verdict]:
        """All unread items."""
        verdicts = []
        with contextlib.suppress(asyncio.QueueEmpty):
            while True:
                verdicts.append(self.queue.get_nowait())
        return verdicts
