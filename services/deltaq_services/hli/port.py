"""What a front needs of the shell that owns it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Protocol

from deltaq_protocol.messages import Status
from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import Output, Sender


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

    def serve(
        self,
        decide: Callable[[], list[Output]],
        robots: Iterable[str] = (),
        sender: Sender | None = None,
        asked: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        """Send what the core decides, see `HliCore.contained`."""
