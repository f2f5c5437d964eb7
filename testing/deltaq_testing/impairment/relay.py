"""The relay for a link, chosen by the link's protocol."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager
from enum import StrEnum
from typing import Any, Protocol, Self

import zenoh
from pydantic import ValidationError

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.endpoint import Endpoint, InvalidEndpointError
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.inbox import ClientInbox
from deltaq_protocol.session import open_session
from deltaq_testing.impairment.tcp import MAX_WAITING_BYTES, FaultyStream, StreamFaults, TcpRelay
from deltaq_testing.impairment.udp import Pump, UdpRelay

# Faults of the lines in a byte stream: each line is lost, duplicated or overtaken as a whole.


class FaultyLines:
    """One direction of a connection that carries a message a line.

    Args:
        seed: of the random numbers that decide what happens to which line.
    """

    def __init__(self, seed: int = 0) -> None:
        self._link = FaultyLink(seed)
        self._begun = bytearray()

    @property
    def faults(self) -> LinkFaults:
        """Faults of the lines; may be set at any time."""
        return self._link.faults

    @faults.setter
    def faults(self, faults: LinkFaults) -> None:
        self._link.faults = faults

    @property
    def waiting_bytes(self) -> int:
        """Bytes of an unfinished line; the link bounds the others."""
        return len(self._begun)

    def put(self, now_s: float, chunk: bytes) -> None:
        """Bytes enter; a line is sent on when its end has come, or when it is too long to be one."""
        *whole, rest = (self._begun + chunk).split(b"\n")
        for line in whole:
            self._link.put(now_s, bytes(line) + b"\n")
        self._begun = rest
        if len(rest) >= MAX_WAITING_BYTES:
            self._link.put(now_s, bytes(rest))
            self._begun = bytearray()

    def take(self, now_s: float) -> list[bytes]:
        """The lines that leave by now."""
        return self._link.take(now_s)

    @property
    def next_s(self) -> float | None:
        """Time at which the next line leaves [s], or None if none waits."""
        return self._link.next_s


# A relay for the messages of zenoh sessions that impairs them one by one.

_WAITING = 1024


class MessageRelay:
    """Relays the messages that either side publishes, on any key; an async context manager. Queries do not pass.

    Args:
        listen: address to which one side connects.
        to: address at which the other side listens.
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


class TrafficUnit(StrEnum):
    """The unit that faults affect."""

    BYTES = "bytes"
    """The byte stream of a TCP connection."""
    LINES = "lines"
    """Each line of a TCP connection, such as JSON lines."""
    MESSAGES = "messages"
    """Each message that a zenoh session publishes over TCP."""
    DATAGRAMS = "datagrams"
    """Each UDP datagram, such as an RSI telegram."""

    @property
    def faults(self) -> type[StreamFaults] | type[LinkFaults]:
        """Kinds of impairment that apply to it."""
        return StreamFaults if self is TrafficUnit.BYTES else LinkFaults


_WORDS = {
    "keeps_order": "kept order",
    "drop": "loss",
    "duplicate": "duplication",
    "reorder": "reordering",
    "corrupt": "corruption",
    "rate_bytes_s": "a rate",
    "stalled": "a stall",
    "cut": "a cut",
}


class InvalidFaultError(DeltaqError):
    """A fault that does not exist for this unit."""


def unit_of(endpoint: Endpoint, name: str = "") -> TrafficUnit:
    """The unit of this name; for an empty name the transport's own.

    Raises:
        InvalidFaultError: if there is no such unit.
    """
    if not name:
        return TrafficUnit.DATAGRAMS if endpoint.transport == "udp" else TrafficUnit.BYTES
    try:
        return TrafficUnit(name)
    except ValueError:
        raise InvalidFaultError(f"no unit {name!r}; there are {', '.join(TrafficUnit)}") from None


def wire_faults(unit: TrafficUnit, asked: Mapping[str, Any]) -> StreamFaults | LinkFaults:
    """The faults of a link, from the fields of `StreamFaults` or `LinkFaults`.

    Raises:
        InvalidFaultError: if it does not apply to this unit.
    """
    allowed = unit.faults.model_fields
    for name in asked:
        if name not in allowed:
            able = ", ".join(other for other in TrafficUnit if name in other.faults.model_fields)
            word = _WORDS.get(name, name)
            raise InvalidFaultError(f"{word} does not apply to {unit}, only to {able}; name another unit")
    try:
        return unit.faults.model_validate(asked)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise InvalidFaultError(f"{first['loc'][0]}: {first['msg']}, got {first['input']}") from error


class Relay(Protocol):
    """A relay at work."""

    def impair(self, faults: Any) -> None:
        """Do this from now on, a `StreamFaults` to bytes or a `LinkFaults` to anything else."""


def relay(
    listen: Endpoint, to: Endpoint, unit: TrafficUnit, seed: int = 0
) -> AbstractAsyncContextManager[Relay]:
    """The relay between two endpoints, to be entered; it has no faults until they are set.

    Args:
        listen: address to which one of the two parties connects or sends.
        to: address at which the other one listens.
        unit: the unit that faults affect.
        seed: of the random numbers.

    Raises:
        InvalidEndpointError: if the transport of an endpoint is not that of the unit.
        ServiceUnreachableError: on entering, if `listen` cannot be listened on.
    """
    transports = ("udp",) if unit is TrafficUnit.DATAGRAMS else ("tcp", "unixsock-stream")
    for endpoint in (listen, to):
        if endpoint.transport not in transports:
            raise InvalidEndpointError(
                f"{endpoint}: {unit} travel over {transports[0]}; write {transports[0]}/HOST:PORT"
            )
    match unit:
        case TrafficUnit.BYTES:
            return TcpRelay(listen, to, FaultyStream, seed)
        case TrafficUnit.LINES:
            return TcpRelay(listen, to, FaultyLines, seed)
        case TrafficUnit.MESSAGES:
            return MessageRelay(listen, to, seed)
        case TrafficUnit.DATAGRAMS:
            return UdpRelay(listen, to, seed)


async def impair_for_a_while(
    listen: Endpoint,
    to: Endpoint,
    unit: TrafficUnit,
    faults: StreamFaults | LinkFaults,
    say: Callable[[str], None],
    *,
    after_s: float = 0.0,
    for_s: float | None = None,
    duration_s: float | None = None,
    seed: int = 0,
) -> None:
    """Carry a link through a relay, with faults for a while.

    Args:
        listen: address to which one of the two parties connects or sends.
        to: address at which the other one listens.
        unit: the unit that faults affect.
        faults: of the link.
        say: called with each event.
        after_s: time until the faults begin.
        for_s: duration of the faults; None for as long as the relay works.
        duration_s: duration of the relay; None for ever.
        seed: of the random numbers.

    Raises:
        InvalidEndpointError: if the transport of an endpoint is not that of the unit.
        ServiceUnreachableError: if `listen` cannot be listened on.
    """
    async with relay(listen, to, unit, seed) as running:
        say(f"carries {unit} from {listen} to {to}; Ctrl-C ends it")
        try:
            async with asyncio.timeout(duration_s):
                await asyncio.sleep(after_s)
                running.impair(faults)
                say(f"impaired: {faults.model_dump_json(exclude_defaults=True)}")
                await asyncio.sleep(for_s if for_s is not None else float("inf"))
                running.impair(unit.faults())
                say("unimpaired again")
                await asyncio.Event().wait()
        except TimeoutError:
            return
