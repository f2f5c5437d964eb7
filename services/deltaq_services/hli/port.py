"""What a front needs of the shell that owns it."""

from __future__ import annotations

import asyncio
from typing import Protocol

from deltaq_protocol.messages import Status
from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import Output


class Port(Protocol):
    """Core, who is who, loop, clock, and a way to carry out what the core decides."""

    core: HliCore
    authentication: Authentication
    roles: ClientRoles
    loop: asyncio.AbstractEventLoop

    def now(self) -> float:
        """Monotonic time [s]."""

    def status(self) -> Status:
        """The running cell, with what the fronts counted."""

    def carry_out(self, outputs: list[Output]) -> None:
        """Send what the core wants sent."""
