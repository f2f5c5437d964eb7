"""Where clients reach a cell: on this machine alone, or from others."""

from __future__ import annotations

import ipaddress

from deltaq_cell.description import CellDescription
from deltaq_protocol.endpoint import Endpoint

NEEDS_TOKENS = "clients_need_tokens"
ALLOWS_ANYBODY = "anyone_who_connects_may_move_the_robots"


def off_loopback(cell: CellDescription) -> tuple[str, str] | None:
    """The first field of a cell that lets clients come from other machines, and its value; None if none does."""
    if not Endpoint.parse(cell.hli).is_loopback:
        return "hli", cell.hli
    if not is_loopback(cell.tcp_address):
        return "tcp_address", cell.tcp_address
    return None


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
