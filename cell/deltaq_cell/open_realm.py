"""Where clients reach a cell: on this machine alone, or from others."""

import ipaddress

from deltaq_cell.description import CellDescription
from deltaq_protocol.endpoint import Endpoint

NEEDS_TOKENS = "clients_need_tokens"
ALLOWS_ANYBODY = "anyone_who_connects_may_move_the_robots"
CROSSES_IN_CLEAR = (
    "zenoh's links of this endpoint are not encrypted, and other machines reach this address: tokens do not cross "
    "them, but an eavesdropper on a link gets the secret of a lease, and can move that robot; write "
    "tls/ in place of tcp/ if clients have identities, put a tunnel between the machines, or listen on 127.0.0.1 and "
    "let clients come over lines with TLS (`tcp_address`)"
)
"""Findings about an `hli` address off the loopback, where clients must prove an identity."""


def off_loopback(cell: CellDescription) -> tuple[str, str] | None:
    """The first field of a cell that lets clients come from other machines, and its value; None if none does."""
    if not Endpoint.parse(cell.hli).is_loopback:
        return "hli", cell.hli
    if not is_loopback(cell.tcp_address):
        return "tcp_address", cell.tcp_address
    return None


def zenoh_in_clear(cell: CellDescription) -> tuple[str, str] | None:
    """The field that lets zenoh's open realm cross a network without encryption, and its value; or None."""
    endpoint = Endpoint.parse(cell.hli)
    return None if endpoint.is_loopback or endpoint.transport == "tls" else ("hli", cell.hli)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
