"""The relay for a wire, chosen by what the wire carries."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from enum import StrEnum
from typing import Any, Protocol

from deltaq_emulator.faults import LinkFaults
from deltaq_experiments.impairment.lines import FaultyLines
from deltaq_experiments.impairment.messages import MessageRelay
from deltaq_experiments.impairment.stream import FaultyStream, StreamFaults
from deltaq_experiments.impairment.tcp import TcpRelay
from deltaq_experiments.impairment.udp import UdpRelay
from deltaq_protocol.endpoint import Endpoint, InvalidEndpointError


class Unit(StrEnum):
    """What is impaired as a whole."""

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
        return StreamFaults if self is Unit.BYTES else LinkFaults


class Relay(Protocol):
    """A relay at work."""

    def impair(self, faults: Any) -> None:
        """Do this from now on, a `StreamFaults` to bytes or a `LinkFaults` to anything else."""


def relay(listen: Endpoint, to: Endpoint, unit: Unit, seed: int = 0) -> AbstractAsyncContextManager[Relay]:
    """The relay between two endpoints, to be entered; it impairs nothing until it is told to.

    Args:
        listen: where one of the two parties is told to connect or to send.
        to: where the other one listens.
        unit: what is impaired as a whole.
        seed: of the random numbers.

    Raises:
        InvalidEndpointError: if the transport of an endpoint is not that of the unit.
        ServiceUnreachableError: on entering, if `listen` cannot be listened on.
    """
    transport = "udp" if unit is Unit.DATAGRAMS else "tcp"
    for endpoint in (listen, to):
        if endpoint.transport != transport:
            raise InvalidEndpointError(
                f"{endpoint}: {unit} travel over {transport}; write {transport}/HOST:PORT"
            )
    match unit:
        case Unit.BYTES:
            return TcpRelay(listen, to, FaultyStream, seed)
        case Unit.LINES:
            return TcpRelay(listen, to, FaultyLines, seed)
        case Unit.MESSAGES:
            return MessageRelay(listen, to, seed)
        case Unit.DATAGRAMS:
            return UdpRelay(listen, to, seed)
