"""A running HLI that keeps an audit log, in a guarded realm that is played."""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from guarded_peer import GuardedPeer, guarded_peer
from small_cell import small_cell, told, tool_pose

from deltaq_protocol.audit import AuditEntry, AuditKind, AuditOutcome
from deltaq_services.hli.authentication import ClientIdentities
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.shell import Hli

OPERATOR, CONTROLLER = "the operator's token, 0123456789", "the controller's, 0123456789"
NOTE = AuditEntry(
    time_utc="",
    time_s=0.0,
    what=AuditKind.NOTE,
    outcome=AuditOutcome.DONE,
    robot="fr",
    text="turn, step 1 of 9",
)
"""What the log keeps of a routine's step."""


class Audited:
    """A running HLI, and its audit log."""

    def __init__(self, hli: Hli, peer: GuardedPeer, file: Path) -> None:
        self.hli, self.peer, self.file = hli, peer, file
        self.port = peer.cell.tcp_port

    def entries(self) -> list[dict[str, Any]]:
        """What is in the file; every line is a whole entry."""
        lines = self.file.read_bytes().splitlines()
        return [AuditEntry.model_validate_json(line).model_dump(mode="json") for line in lines]

    async def entry(self, what: str, outcome: str, **fields: Any) -> dict[str, Any]:
        """The first entry of this kind and outcome, with these fields; waits for it."""
        wanted = {"what": what, "outcome": outcome} | fields
        async with asyncio.timeout(300):
            while True:
                for entry in self.entries():
                    if wanted.items() <= entry.items():
                        return entry
                await asyncio.sleep(0.01)

    async def counted(self, what: str, wanted: int) -> list[dict[str, Any]]:
        """Entries of a kind, once their counts have come to what is wanted."""
        async with asyncio.timeout(300):
            while True:
                found = [entry for entry in self.entries() if entry["what"] == what]
                if sum(entry["count"] for entry in found) >= wanted:
                    return found
                await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def audited(
    file: Path, encryption: ssl.SSLContext | None = None, identities: ClientIdentities | None = None
) -> AsyncIterator[Audited]:
    cell, roles = small_cell(), ClientRoles(OPERATOR, CONTROLLER)
    async with (
        guarded_peer(cell) as peer,
        Hli(cell, told(cell), tool_pose, roles, encryption, file, identities) as hli,
    ):
        await peer.turn()
        yield Audited(hli, peer, file)
