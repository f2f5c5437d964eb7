"""The shell of the HLI: sockets, sessions and time. It decides nothing."""

from __future__ import annotations

import asyncio
import secrets
import ssl
import time
from collections import Counter
from collections.abc import Callable

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.guarded import Health
from deltaq_protocol.messages import Description, RobotState, Status, ToolPose
from deltaq_protocol.topic import Realm
from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.core import HliCore
from deltaq_services.hli.guarded_front import GuardedFront
from deltaq_services.hli.open_front import OpenFront
from deltaq_services.hli.tcp_front import TcpFront
from deltaq_services.outputs import Output, ToSender
from deltaq_services.pace import Pace

_TICK_S = 0.02


class Hli:
    """The running HLI, to be used as an async context manager; it listens while inside.

    Args:
        cell: description of the cell.
        told: the cell's description for clients.
        tool_pose: pose of a robot's tool from its name and its n joints `q` [rad or m].
        roles: of clients; None: everybody is an operator.
        encryption: of the lines over TCP; None: they are in the clear.

    Raises:
        ServiceUnreachableError: on entering, if the open realm's endpoint cannot be listened on.
        OSError: on entering, if the TCP port cannot be listened on.
    """

    def __init__(
        self,
        cell: CellDescription,
        description: Description,
        tool_pose: Callable[[str, tuple[float, ...]], ToolPose],
        roles: ClientRoles | None = None,
        encryption: ssl.SSLContext | None = None,
    ) -> None:
        # milliseconds since 1970: greater than any epoch that an earlier process has reached
        first_epoch = time.time_ns() // 1_000_000
        self.roles = roles or ClientRoles()
        self._encryption = encryption
        self.core = HliCore(
            cell, description, tool_pose, lambda: secrets.token_hex(16), first_epoch, self.roles
        )
        self.authentication = Authentication(self.core.leases, self.roles, secrets.token_hex(32))
        self.loop: asyncio.AbstractEventLoop
        self._cell = cell
        self._pace = Pace(topics.HEALTH.period_s(cell.cycle_s))

    async def __aenter__(self) -> Hli:
        self.loop = asyncio.get_running_loop()
        self._tcp = TcpFront(self)
        await self._tcp.listen(self._cell.tcp_address, self._cell.tcp_port, self._encryption)
        try:
            self._guarded = GuardedFront(self._cell, self)
            try:
                self._open = OpenFront(self._cell, self)
            except BaseException:
                self._guarded.close()
                raise
        except BaseException:
            await self._tcp.close()
            raise
        self._next_tick = self.loop.call_soon(self._tick)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._next_tick.cancel()
        await self._tcp.close()
        self._open.close()
        self._guarded.close()

    def now(self) -> float:
        """Monotonic time [s]."""
        return self.loop.time()

    def status(self) -> Status:
        """The running cell, with what the fronts counted."""
        return self.core.status(self.now(), self._front_counters())

    def carry_out(self, outputs: list[Output]) -> None:
        """Send what the core wants sent, in its order."""
        for output in outputs:
            if isinstance(output, ToSender):
                output.sender.deliver(output.message)
            elif output.topic.realm is Realm.GUARDED:
                self._guarded.publish(output.topic, output.robot, output.message)
            else:
                self._open.publish(output.topic, output.robot, output.message)
                if isinstance(output.message, RobotState):
                    self._tcp.publish_state(output.message)

    def _tick(self) -> None:
        now = self.now()
        self._next_tick = self.loop.call_at(now + _TICK_S, self._tick)
        self.carry_out(self.core.on_tick(now))
        if self._pace.due(now):
            self._publish_health(now)

    def _publish_health(self, now: float) -> None:
        lagging = self.core.lagging(now)
        counters = self.core.counters + self._front_counters()
        details = (*self.core.mismatches, *((f"lagging: {'; '.join(lagging)}",) if lagging else ()))
        health = Health(
            service="hli",
            healthy=not self.core.mismatches,
            detail="; ".join(details),
            cell=self.core.description.identity,
            time_s=now,
            counters=dict(counters),
        )
        self._guarded.publish(topics.HEALTH, "", health)

    def _front_counters(self) -> Counter[str]:
        counters = self._tcp.counters + self._open.counters() + self._guarded.counters()
        counters["tcp_connections_open"] = len(self._tcp.connections)
        return counters
