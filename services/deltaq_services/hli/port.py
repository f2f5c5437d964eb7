"""The interface of the HLI's shell for its fronts."""

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
    """The shell as the fronts see it: core, authentication, loop, clock, and execution of decisions."""

    core: HliCore
    authentication: Authentication
    roles: ClientRoles
    loop: asyncio.AbstractEventLoop

    def now(self) -> float:
        """Monotonic time [s]."""

    def status(self) -> Status:
        """The running cell, with the fronts' counters."""

    def serve(
        self,
        decide: Callable[[], list[Output]],
        robots: Iterable[str] = (),
        sender: Sender | None = None,
        asked: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        """Let the core decide, and send its messages; see `HliCore.contained`."""
