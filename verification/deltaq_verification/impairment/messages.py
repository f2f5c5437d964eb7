"""A relay for the messages of zenoh sessions that impairs them one by one."""

from __future__ import annotations

import asyncio
from typing import Any, Self

import zenoh

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.inbox import ClientInbox
from deltaq_protocol.session import open_session
from deltaq_verification.impairment.pump import Pump

_WAITING = 1024


class MessageRelay:
    """Relays the messages that either side publishes, on any key; an async context manager. Queries do not pass.

    Args:
        listen: where one side connects.
        to: where the other side listens.
        seed: of the random numbers.

    Raises:
        ServiceUnreachableError: on entering, if `listen` cannot be listened on.
    """

    def __init__(self, listen: Endpoint, to: Endpoint, seed: int = 0) -> None:
        self._listen, self._to, self._seed = listen, to, seed

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        near = open_session(listen=[str(self._listen)])
        far = open_session(connect=[str(self._to)])
        self._ways = (_Way(loop, near, far, self._seed), _Way(loop, far, near, self._seed + 1))
        self._sessions = (near, far)
        return self

    async def __aexit__(self, *_: object) -> None:
        for way in self._ways:
            way.close()
        for session in self._sessions:
            session.close()

    def impair(self, faults: LinkFaults) -> None:
        """Set the faults from now on, in both directions."""
        for way in self._ways:
            way.pump.impair(faults)


class _Way:
    """From one session to the other."""

    def __init__(self, loop: asyncio.AbstractEventLoop, source: Any, target: Any, seed: int) -> None:
        self._target = target
        self.pump = Pump(loop, self._publish, seed)
        self._inbox = ClientInbox[zenoh.Sample](loop, self._take, _WAITING)
        self._subscriber = source.declare_subscriber(
            "**",
            zenoh.handlers.Callback(self._inbox.put, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )

    def close(self) -> None:
        self._subscriber.undeclare()
        self._inbox.close()
        self.pump.close()

    def _take(self, sample: zenoh.Sample) -> None:
        self.pump.put(str(sample.key_expr).encode() + b"\n" + sample.payload.to_bytes())

    def _publish(self, message: bytes) -> None:
        key, _, payload = message.partition(b"\n")
        try:
            wire_key = zenoh.KeyExpr(key.decode())
        except (UnicodeDecodeError, zenoh.ZError):
            return  # its key is garbled: the destination is unknown
        self._target.put(
            wire_key,
            payload,
            express=True,
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.DROP,
        )
