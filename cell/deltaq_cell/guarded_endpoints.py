"""Endpoints of the guarded realm: Unix sockets on one machine, TLS between several."""

from __future__ import annotations

from typing import NamedTuple

from deltaq_cell.description import LOCAL, CellDescription
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.sayings import SIM, robot_server


class GuardedEndpoint(NamedTuple):
    """Where one service listens.

    Attributes:
        service: its name.
        field: path of the cell's field that says so.
        text: the field's value.
    """

    service: str
    field: tuple[str, ...]
    text: str

    @property
    def place(self) -> str:
        """The field and its value, as text."""
        return f"{'.'.join(self.field)} ({self.text})"


def guarded_endpoints(cell: CellDescription) -> tuple[GuardedEndpoint, ...]:
    """The endpoints of the SIM and of every Robot Server."""
    robots = (
        GuardedEndpoint(robot_server(name), ("robots", name, "server"), robot.server)
        for name, robot in cell.robots.items()
    )
    return GuardedEndpoint(SIM, ("sim",), cell.sim), *robots


def is_on_one_machine(cell: CellDescription) -> bool:
    """Whether no service of the guarded realm listens over TLS."""
    return all(not endpoint.text.startswith("tls/") for endpoint in guarded_endpoints(cell))


def guarded_fault(cell: CellDescription) -> tuple[GuardedEndpoint, str] | None:
    """The first endpoint with which the guarded realm cannot start, and why; None if all are right."""
    encrypted = [each for each in guarded_endpoints(cell) if each.text.startswith("tls/")]
    for each in guarded_endpoints(cell):
        if each.text.startswith("tcp/") and not Endpoint.parse(each.text).is_loopback:
            return each, (
                "other machines reach this address, and plain tcp/ lets all of them in; write tls/HOST:PORT and make "
                "identities with `deltaq keys --cell CELL --output FOLDER`, or leave the field out on one machine"
            )
        if encrypted and each not in encrypted:
            return each, (
                f"{encrypted[0].place} is encrypted, so every service of the guarded realm has to be; "
                "write tls/HOST:PORT here too"
            )
    return None


def socket_name(endpoint: GuardedEndpoint) -> str | None:
    """The name of an endpoint's Unix socket in the folder of the launch; None over TLS.

    `tcp/` on the loopback is such a socket too: cells of before have it, and no port is opened.
    """
    kind, _, name = endpoint.text.partition("/")
    if kind == LOCAL:
        return f"{name or endpoint.service}.sock"
    return f"{endpoint.service}.sock" if kind == "tcp" else None
