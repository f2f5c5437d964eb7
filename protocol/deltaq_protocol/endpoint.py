"""The address of a listener, as cells and commands write it: `tcp/HOST:PORT`, `tls/HOST:PORT` or `udp/HOST:PORT`.

`unixsock-stream/PATH` is a Unix socket, of an absolute path.

`tcp+udp/HOST:PORT` is both at one port, for a session over a network that loses packets: messages that must arrive
use TCP, streams use UDP, where a lost packet delays no other.
"""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from typing import Literal, cast

from deltaq_protocol.errors import DeltaqError

Transport = Literal["tcp", "tls", "udp", "tcp+udp", "unixsock-stream"]
Address = tuple[str, int]
"""Host and port, as a socket has them."""

_FORM = re.compile(r"(tcp\+udp|tcp|tls|udp)/(?:\[([^\]\s]+)\]|([^\s/:\[\]]+)):(\d{1,5})")


class InvalidEndpointError(DeltaqError):
    """A text that is no endpoint."""


@dataclass(frozen=True)
class Endpoint:
    """A transport, a host by name or number, and a port; of a Unix socket its path, and 0."""

    transport: Transport
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Endpoint:
        """Read an endpoint.

        >>> Endpoint.parse("tcp/127.0.0.1:7447")
        Endpoint(transport='tcp', host='127.0.0.1', port=7447)

        Raises:
            InvalidEndpointError: if it has another form, or a port beyond 1 to 65535.
        """
        if text.startswith("unixsock-stream//"):
            return cls("unixsock-stream", text.removeprefix("unixsock-stream/"), 0)
        found = _FORM.fullmatch(text)
        if found is None or not 1 <= int(found[4]) <= 65535:
            raise InvalidEndpointError(
                f"{text!r} is no endpoint; write tcp/HOST:PORT, tls/, udp/ or tcp+udp/ with a port of 1 to 65535, "
                "e.g. tcp/127.0.0.1:7447"
            )
        return cls(cast(Transport, found[1]), found[2] or found[3], int(found[4]))

    @property
    def address(self) -> Address:
        """Host and port."""
        return self.host, self.port

    @property
    def sockets(self) -> tuple[Literal["tcp", "udp"], ...]:
        """Kinds of sockets that a listener here has."""
        if self.transport == "tcp+udp":
            return "tcp", "udp"
        if self.transport == "unixsock-stream":
            return ()
        return ("udp",) if self.transport == "udp" else ("tcp",)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        if self.transport == "unixsock-stream":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def __str__(self) -> str:
        if self.transport == "unixsock-stream":
            return f"{self.transport}/{self.host}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.transport}/{host}:{self.port}"
