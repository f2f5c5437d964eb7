"""The console's connection to the HLI: messages are stored undecoded, and read 25 times a second.

Zenoh's threads only store the bytes: decoding every state, or waking the loop for it, would take processor time from
the cell.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from deltaq_protocol import topics
from deltaq_protocol.certified.encryption import client_tls
from deltaq_protocol.role_prover import RoleProver
from deltaq_protocol.session import open_session
from deltaq_protocol.wire import Asking, Wire, in_order

_MOST_VERDICTS = 1000
"""Verdicts of a robot that may wait to be read: a tick's worth, many times over."""


@dataclass
class RobotNews:
    """Messages about one robot since the last reading.

    Attributes:
        states: the newest two, as bytes; two following ones show how fast the setpoint moves.
        state_s: when the newest came [s].
        longest_gap_s: the longest time between two states [s].
        verdicts: as bytes.
    """

    states: list[bytes] = field(default_factory=list)
    state_s: float = 0.0
    longest_gap_s: float = 0.0
    verdicts: list[bytes] = field(default_factory=list)


class _Ear:
    """Stores the messages of one robot; callable from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._states: deque[bytes] = deque(maxlen=2)
        self._verdicts: deque[bytes] = deque(maxlen=_MOST_VERDICTS)
        self._last_s: float | None = None
        self._gap_s = 0.0

    def state(self, sample: Any) -> None:
        now_s, payload = time.monotonic(), sample.payload.to_bytes()
        with self._lock:
            if self._last_s is not None:
                self._gap_s = max(self._gap_s, now_s - self._last_s)
            self._last_s = now_s
            self._states.append(payload)

    def verdict(self, sample: Any) -> None:
        payload = sample.payload.to_bytes()
        with self._lock:
            self._verdicts.append(payload)

    def heard(self) -> RobotNews:
        with self._lock:
            heard = RobotNews(list(self._states), self._last_s or 0.0, self._gap_s, list(self._verdicts))
            self._states.clear()
            self._verdicts.clear()
            self._gap_s = 0.0
        return heard


class HliLink:
    """The console's connection to the HLI; a context manager. The HLI may restart meanwhile.

    Args:
        hli: address of the HLI.
        cell: name of the cell.
        robots: names of its robots.
        role: shows the console's role; None if it has none to show.
    """

    def __init__(self, hli: str, cell: str, robots: tuple[str, ...], role: RoleProver | None) -> None:
        self._hli, self._cell, self._role = hli, cell, role
        self._ears = {robot: _Ear() for robot in robots}
        self._proximity: deque[bytes] = deque(maxlen=1)
        self._wire: Wire | None = None
        self._asking: Asking
        self._entered = asyncio.Event()

    async def __aenter__(self) -> HliLink:
        session = await asyncio.to_thread(open_session, connect=[self._hli], tls=client_tls(self._hli))
        self._wire = wire = Wire(session, asyncio.get_running_loop())
        for robot, ear in self._ears.items():
            wire.subscribe_unqueued(topics.STATE.key(self._cell, robot=robot), in_order(ear.state))
            wire.subscribe_unqueued(topics.VERDICT.key(self._cell, robot=robot), ear.verdict)
        wire.subscribe_unqueued(topics.PROXIMITY.key(self._cell), self._put_proximity)
        self._asking = Asking(wire, self._cell, self._role)
        self._entered.set()
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._wire is not None:
            await asyncio.to_thread(self._wire.close)

    async def asking(self) -> Asking:
        """The interface for queries to the HLI; waits until there is a session."""
        await self._entered.wait()
        return self._asking

    def heard(self, robot: str) -> RobotNews:
        """What came of a robot since this was asked last."""
        return self._ears[robot].heard()

    def proximity(self) -> bytes | None:
        """The newest proximity since the last call; None without one."""
        with contextlib.suppress(IndexError):
            return self._proximity.pop()
        return None

    def _put_proximity(self, sample: Any) -> None:
        self._proximity.append(sample.payload.to_bytes())
