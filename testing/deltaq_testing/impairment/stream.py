"""Faults of a byte stream, as a queue in time: no clock is used here, and one seed is one run.

A stream such as TCP keeps every byte and their order, so it can only be late, slow or stalled. Only
messages can be lost, duplicated or overtaken: see `deltaq_emulator.faults`.
"""

import random
from collections import deque
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from deltaq_emulator.faults import Seconds

MAX_WAITING_BYTES = 1024 * 1024
"""Bytes that wait in one direction; beyond, no more are read from the sender."""


class StreamFaults(BaseModel):
    """Faults of the bytes of a connection in one direction; none by default."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    delay_s: Seconds = 0.0
    """Their delay."""
    jitter_s: Seconds = 0.0
    """Their largest additional delay, uniformly distributed; none overtakes another."""
    rate_bytes_s: Annotated[float, Field(gt=0)] | None = None
    """Bytes per second; None for no limit."""
    stalled: bool = False
    """Nothing passes and nothing is lost, as when a cable is pulled: all of it arrives once this ends."""
    cut: bool = False
    """Connections are broken, and new ones refused."""


class FaultyStream:
    """One direction of a connection.

    Args:
        seed: of the random delays.

    Attributes:
        faults: may be set at any time.
        waiting_bytes: bytes that have entered and not left.
    """

    def __init__(self, seed: int = 0) -> None:
        self.faults = StreamFaults()
        self.waiting_bytes = 0
        self._random = random.Random(seed)
        self._queue: deque[tuple[float, bytes]] = deque()
        self._last_due_s = 0.0

    def put(self, now_s: float, chunk: bytes) -> None:
        """Bytes enter the stream."""
        faults = self.faults
        due_s = max(self._last_due_s, now_s + faults.delay_s + self._random.random() * faults.jitter_s)
        if faults.rate_bytes_s is not None:
            due_s += len(chunk) / faults.rate_bytes_s
        self._last_due_s = due_s
        self._queue.append((due_s, chunk))
        self.waiting_bytes += len(chunk)

    def take(self, now_s: float) -> list[bytes]:
        """The chunks that leave the stream by now, in order."""
        out: list[bytes] = []
        while not self.faults.stalled and self._queue and self._queue[0][0] <= now_s:
            out.append(self._queue.popleft()[1])
        self.waiting_bytes -= sum(map(len, out))
        return out

    @property
    def next_s(self) -> float | None:
        """Time at which the next bytes leave [s]; None if none wait, or the stream is stalled."""
        return self._queue[0][0] if self._queue and not self.faults.stalled else None
