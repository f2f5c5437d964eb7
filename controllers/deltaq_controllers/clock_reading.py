"""Reads the clocks of the Robot Servers of a running cell, and reads them again now and then: clocks drift."""

from __future__ import annotations

import asyncio
import contextlib
import time

from deltaq_controllers.robot_clocks import RobotClocks
from deltaq_protocol.client import Cell
from deltaq_protocol.errors import ServiceUnreachableError

_EXCHANGES = 5
"""Requests by which clocks are read at first; the quickest is believed."""
_AGAIN_S, _SOON_S = 2.0, 0.1
"""Time between two exchanges, and while the clock of a robot that is heard is not known."""


class ClockReading:
    """Keeps the clocks of a cell's robots up to date.

    Args:
        cell: connection to the cell.

    Attributes:
        clocks: the clocks, as far as they are known.
    """

    def __init__(self, cell: Cell) -> None:
        self.clocks = RobotClocks(cell.robots, cell.description.cycle_s)
        self._cell = cell
        self._asked_s = -_AGAIN_S
        self._under_way: asyncio.Task[None] | None = None

    async def read_first(self) -> None:
        """Read the clocks of all robots that are heard.

        Of a busy machine some answers come too late, and tell nothing of a clock.

        Raises:
            ServiceUnreachableError: none has come in time.
        """
        unanswered = 0
        for _ in range(_EXCHANGES):
            try:
                await self._exchange()
            except ServiceUnreachableError:
                unanswered += 1
                if unanswered == _EXCHANGES:
                    raise

    def go_on(self) -> None:
        """Ask again if it is due; to be called once a cycle. The answer is not waited for, and one may be missing."""
        if self._under_way is not None and not self._under_way.done():
            return
        heard = [name for name in self._cell.robots if self._cell.state(name) is not None]
        pause_s = _AGAIN_S if all(map(self.clocks.knows, heard)) else _SOON_S
        if time.monotonic() >= self._asked_s + pause_s:
            self._under_way = asyncio.create_task(self._exchange_if_answered())

    async def _exchange_if_answered(self) -> None:
        with contextlib.suppress(ServiceUnreachableError):
            await self._exchange()

    async def _exchange(self) -> None:
        states = {name: self._cell.state(name) for name in self._cell.robots}
        newest = {name: state for name, state in states.items() if state is not None}
        self._asked_s = asked_s = time.monotonic()
        status = await self._cell.status()
        self.clocks.take(asked_s, status, time.monotonic(), newest)
