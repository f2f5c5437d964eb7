"""Delivers what a faulty link lets through, when it is due, in an event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from deltaq_emulator.faults import FaultyLink, LinkFaults


class Pump:
    """One direction of a link that carries whole messages.

    Args:
        loop: that carries.
        deliver: called with each message that arrives.
        seed: of the link's random numbers.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, deliver: Callable[[bytes], None], seed: int = 0
    ) -> None:
        self._loop, self._deliver = loop, deliver
        self._link = FaultyLink(seed)
        self._timer: asyncio.TimerHandle | None = None

    @property
    def counts(self) -> Mapping[str, int]:
        """Faults so far."""
        return self._link.counts

    def impair(self, faults: LinkFaults) -> None:
        """Do this from now on."""
        self._link.faults = faults

    def put(self, message: bytes) -> None:
        """A message enters."""
        self._link.put(self._loop.time(), message)
        self._carry()

    def close(self) -> None:
        """Stop delivering."""
        if self._timer is not None:
            self._timer.cancel()

    def _carry(self) -> None:
        self.close()
        for message in self._link.take(self._loop.time()):
            self._deliver(message)
        if self._link.next_s is not None:
            self._timer = self._loop.call_at(self._link.next_s, self._carry)
