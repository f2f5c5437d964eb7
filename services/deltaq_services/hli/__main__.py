"""Run the high-level interface of a cell: `python -m deltaq_services.hli --cell lab`."""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import signal
import ssl
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import CellDescription
from deltaq_cell.open_realm import CROSSES_IN_CLEAR, zenoh_in_clear
from deltaq_protocol.certified.names import AUTHORITY_FILE, IDENTITY
from deltaq_protocol.messages import Description, ToolPose
from deltaq_protocol.real_time import SchedulingPriority, ask_for_real_time
from deltaq_services.hli.client_roles import ClientRoles, client_roles
from deltaq_services.hli.line_encryption import line_encryption
from deltaq_services.hli.shell import Hli
from deltaq_services.hli.zenoh_session import let_threads_wait
from deltaq_services.process import arguments, run

if TYPE_CHECKING:
    from deltaq_services.hli.authentication import ClientIdentities
_log = logging.getLogger(__name__)

_MOST_OPEN = 16_384
"""Files and sockets of this process."""


async def _run(
    model: CellModel,
    description: Description,
    roles: ClientRoles,
    encryption: ssl.SSLContext | None,
    audit_file: Path | None,
    identities: ClientIdentities | None,
) -> None:
    cell = model.description

    def tool_pose(robot: str, q: tuple[float, ...], tool: str = "tool") -> ToolPose:
        return model.robots[robot].tool_pose(q, tool)

    loop = asyncio.get_running_loop()
    stopped = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopped.set)
    async with Hli(cell, description, tool_pose, roles, encryption, audit_file, identities):
        lines = f"{cell.tcp_address}:{cell.tcp_port}"
        _log.info("ready: hli of %s on %s and tcp %s", cell.cell, cell.hli, lines)
        await stopped.wait()


def _allow_many_connections() -> None:
    """Raise the limit of open files, so that a flood of connections does not use it up."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _MOST_OPEN if hard == resource.RLIM_INFINITY else min(hard, _MOST_OPEN)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))


def _client_identities(cell: CellDescription) -> tuple[ClientIdentities | None, str]:
    """The checker of clients' identities and the authority's certificate; None and empty without an authority."""
    if not (os.environ.get(IDENTITY) or os.environ.get(AUTHORITY_FILE)):
        return None, ""
    from cryptography.hazmat.primitives.serialization import Encoding

    from deltaq_protocol.certified.certificate import now_utc
    from deltaq_services.hli.authentication import ClientIdentities
    from deltaq_services.service_identity import authority_of_clients

    authority = authority_of_clients(cell, os.environ)
    return ClientIdentities(authority, now_utc), authority.public_bytes(Encoding.PEM).decode()


def main() -> None:
    """Serve the clients of a cell."""
    options = arguments("High-level interface: between controllers and the gate", writes_audit=True)
    let_threads_wait()
    # zenoh's threads hand over in microseconds instead of waiting for the interpreter's usual 5 ms
    sys.setswitchinterval(0.0005)
    cell = CellModel.load(options.cell)
    roles = client_roles(cell.description)
    identities, authority = _client_identities(cell.description)
    encryption = line_encryption(cell.description, authority=authority)
    if (crosses := zenoh_in_clear(cell.description)) is not None and (roles.tokens or identities):
        _log.warning("%s (%s): %s", *crosses, CROSSES_IN_CLEAR)
    description = cell.description_message()
    _allow_many_connections()
    ask_for_real_time(SchedulingPriority.HLI)
    asyncio.run(_run(cell, description, roles, encryption, options.audit, identities))


if __name__ == "__main__":
    run(main, "hli")
