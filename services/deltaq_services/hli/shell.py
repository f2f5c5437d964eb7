"""The shell of the HLI: sockets, sessions and time. It decides nothing.

Zenoh's messages are taken in zenoh's threads, lines and queries in the event loop. A lock lets one thread at a time
decide, and send the result.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.audit import AuditEntry, AuditKind, AuditOutcome
from deltaq_protocol.guarded import Health
from deltaq_protocol.heartbeat import Heartbeat
from deltaq_protocol.messages import Description, RobotState, Status, ToolPose
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Realm
from deltaq_services.hli.audit import Audit
from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.commands import Deed
from deltaq_services.hli.core import HliCore
from deltaq_services.hli.guarded_front import GuardedFront
from deltaq_services.hli.open_front import OpenFront
from deltaq_services.hli.tcp_front import TcpFront
from deltaq_services.outputs import ClientOrigin, Output, Sender, ToSender
from deltaq_services.rate_limit import Pace

if TYPE_CHECKING:
    from deltaq_services.hli.authentication import ClientIdentities

_log = logging.getLogger(__name__)

_TICK_S = 0.02

M = TypeVar("M")


class Hli:
    """The running HLI, to be used as an async context manager; it listens while inside.

    Args:
        cell: description of the cell.
        description: the cell's description for clients.
        tool_pose: pose of a robot's tool from its name, its n joints `q` [rad or m], and the coupled tool, if any.
        roles: of clients; None: every client is an operator.
        encryption: of the lines over TCP; None: they are in the clear.
        audit_file: of the audit log; None: it goes to recorders alone.
        identities: of clients; None: they prove roles by tokens alone.

    Raises:
        AuditFileError: on entering, if the audit log cannot be written.
        ServiceUnreachableError: on entering, if the open realm's endpoint cannot be listened on.
        OSError: on entering, if the TCP port cannot be listened on.
    """

    def __init__(
        self,
        cell: CellDescription,
        description: Description,
        tool_pose: Callable[..., ToolPose],
        roles: ClientRoles | None = None,
        encryption: ssl.SSLContext | None = None,
        audit_file: Path | None = None,
        identities: ClientIdentities | None = None,
    ) -> None:
        # milliseconds since 1970: greater than any epoch that an earlier process has reached
        first_epoch = time.time_ns() // 1_000_000
        self.roles = roles or ClientRoles()
        self._encryption = encryption
        self.core = HliCore(
            cell, description, tool_pose, lambda: secrets.token_hex(16), first_epoch, self.roles, self._tell
        )
        self._audit_file = audit_file
        self._unproven = 0
        self._ended = False
        self._lock = threading.RLock()
        self.authentication = Authentication(self.core.leases, self.roles, secrets.token_hex(32), identities)
        self.loop: asyncio.AbstractEventLoop
        self._cell = cell
        self._heartbeat = Heartbeat()
        self._pace = Pace(topics.HEALTH.period_s(cell.cycle_s))

    async def __aenter__(self) -> Hli:
        self.loop, self._loop_thread = asyncio.get_running_loop(), threading.get_ident()
        self._audit = Audit(self._audit_file, self._publish_entry, self._secrets, self.now)
        try:
            return await self._begin()
        except BaseException:
            self._audit.close()
            raise

    async def _begin(self) -> Hli:
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
        with self._lock:  # the threads of a front may still decide while the other front closes
            self._ended = True
        self._open.close()
        self._tell_of_unproven()
        self._audit.close()
        self._guarded.close()
        self._heartbeat.close()

    def now(self) -> float:
        """Monotonic time [s]."""
        return self.loop.time()

    def status(self) -> Status:
        """The running cell, with the fronts' counters."""
        with self._lock:
            return self.core.status(self.now(), self._front_counters())

    def serve(
        self,
        decide: Callable[[], list[Output]],
        robots: Iterable[str] = (),
        sender: Sender | None = None,
        asked: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        """Let the core decide, and send its messages in order.

        A message that fails is lost, see `HliCore.contained`. Callable from any thread.
        """
        with self._lock:
            if self._ended:
                return
            for output in self.core.contained(decide, self.now(), robots, sender, asked):
                try:
                    self._send(output)
                except Exception as error:
                    self.core.failed(error)
            self.core.containment.log_once(_log)

    def _send(self, output: Output) -> None:
        if isinstance(output, ToSender):
            self._in_loop(output.sender.deliver, output.message)
        elif output.topic.realm is Realm.GUARDED:
            self._guarded.publish(output.topic, output.robot, output.message)
        else:
            self._open.publish(output.topic, output.robot, output.message)
            if isinstance(output.message, RobotState) and self._tcp.connections:
                self._in_loop(self._tcp.publish_state, output.message)

    def _in_loop(self, do: Callable[[M], None], message: M) -> None:
        """Connections belong to the loop; in its own thread nothing has to wait for it."""
        if threading.get_ident() == self._loop_thread:
            do(message)
        else:
            self.loop.call_soon_threadsafe(do, message)

    def _tell(self, deed: Deed) -> None:
        with self._lock:
            self._audit.tell(deed)

    def _publish_entry(self, entry: AuditEntry) -> None:
        self._guarded.publish(topics.AUDIT_ENTRY, "", entry)

    def _secrets(self) -> tuple[str, ...]:
        return *self.roles.tokens, *self.core.leases.tokens()

    def _tell_of_unproven(self) -> None:
        """Report increments without a proof: zenoh's threads count them without decoding them."""
        before, self._unproven = self._unproven, self._open.unproven
        if self._unproven > before:
            deed = Deed(
                AuditKind.INCREMENT,
                AuditOutcome.REFUSED,
                ClientOrigin(address="zenoh"),
                code=ReasonCode.LEASE_NOT_HELD,
                text="no proof of a lease came with it",
            )
            self._audit.tell(deed, self._unproven - before)

    def _tick(self) -> None:
        now = self.now()
        self._next_tick = self.loop.call_at(now + _TICK_S, self._tick)
        self.serve(lambda: self.core.on_tick(now), self._cell.robots)
        with self._lock:
            self._tell_of_unproven()
            self._audit.tick()
            if self._pace.due(now):
                self._publish_health(now)

    def _publish_health(self, now: float) -> None:
        lagging = self.core.lagging(now)
        counters = self.core.counters + self._front_counters()
        said = f"lagging: {'; '.join(lagging)}" if lagging else ""
        details = [text for text in (*self.core.mismatches, said, self._audit.fault) if text]
        health = Health(
            service="hli",
            healthy=not self.core.mismatches,
            detail="; ".join(details),
            cell=self.core.description.identity,
            time_s=now,
            counters=dict(counters),
        )
        self._guarded.publish(topics.HEALTH, "", health)
        if self._heartbeat.is_due(now):
            age_s = self.core.gate_age_s(now)
            is_heard = age_s is not None and age_s <= topics.HEALTH.age_s(self._cell.cycle_s)
            detail = health.detail if is_heard else "the SIM is silent"
            self._heartbeat.beat(now, health.healthy and is_heard, detail)

    def _front_counters(self) -> Counter[str]:
        counters = self._tcp.counters + self._open.counters() + self._guarded.counters()
        counters += self._audit.counters
        counters["tcp_connections_open"] = len(self._tcp.connections)
        counters["audit_lines"] = self._audit.lines
        counters["audit_lines_lost"] = self._audit.lost
        counters["audit_entries_unpublished"] = self._audit.unpublished
        return counters
