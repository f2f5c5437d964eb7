"""The relay for a link, chosen by what the link carries."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from enum import StrEnum
from typing import Any, Protocol

from pydantic import ValidationError

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Endpoint, InvalidEndpointError
from deltaq_protocol.errors import DeltaqError
from deltaq_verification.impairment.lines import FaultyLines
from deltaq_verification.impairment.messages import MessageRelay
from deltaq_verification.impairment.stream import FaultyStream, StreamFaults
from deltaq_verification.impairment.tcp import TcpRelay
from deltaq_verification.impairment.udp import UdpRelay


class TrafficUnit(StrEnum):
    """The unit that faults affect."""

    BYTES = "bytes"
    """The byte stream of a TCP connection, whatever it carries."""
    LINES = "lines"
    """Each line of a TCP connection, such as JSON lines."""
    MESSAGES = "messages"
    """Each message that a zenoh session publishes over TCP."""
    DATAGRAMS = "datagrams"
    """Each UDP datagram, such as an RSI telegram."""

    @property
    def faults(self) -> type[StreamFaults] | type[LinkFaults]:
        """What can befall it."""
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
    """The unit of this name; of an empty one, what the transport itself carries.

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
        InvalidFaultError: if it cannot befall this unit.
    """
    allowed = unit.faults.model_fields
    for name in asked:
        if name not in allowed:
            able = ", ".join(other for other in TrafficUnit if name in other.faults.model_fields)
            word = _WORDS.get(name, name)
            raise InvalidFaultError(f"{word} cannot befall {unit}, only {able}; name another unit")
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
    transport = "udp" if unit is TrafficUnit.DATAGRAMS else "tcp"
    for endpoint in (listen, to):
        if endpoint.transport != transport:
            raise InvalidEndpointError(
                f"{endpoint}: {unit} travel over {transport}; write {transport}/HOST:PORT"
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
