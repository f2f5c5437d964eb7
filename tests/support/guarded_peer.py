"""The guarded realm of a cell, played by a peer: it speaks real zenoh, as SIM and Robot Servers would."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import zenoh
from small_cell import server_state

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.audit import AuditEntry
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.envelope import Envelopes, message_in, sender_of
from deltaq_protocol.guarded import Command, CommandReply, Health, Plan, Request
from deltaq_protocol.messages import Message, Outcome, Phase, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.sayings import HLI, SIM, robot_server
from deltaq_protocol.session import declare_publisher, open_session
from deltaq_services.guarded_realm import guarded_links


class GuardedPeer:
    """Publishes states, admits what it is asked, obeys commands; each of which can be switched off.

    Attributes:
        increments: requests with an increment, as they came.
        commands: as they came.
        health: the HLI's heartbeats, as they came.
        entries: of the audit log, as they came.
        judges: answers requests with verdicts.
        refuses: reason for which commands are refused.
        tools: that are coupled, by robot.
    """

    def __init__(self, cell: CellDescription) -> None:
        self.cell = cell
        self.increments: asyncio.Queue[Request] = asyncio.Queue()
        self.commands: asyncio.Queue[Command] = asyncio.Queue()
        self.health: asyncio.Queue[Health] = asyncio.Queue()
        self.entries: asyncio.Queue[AuditEntry] = asyncio.Queue()
        self.judges = True
        self.obeys = True
        self.refuses: ReasonCode | None = None
        self.cycle = 100
        self.q_cmd = {name: (0.1,) * len(robot.joints) for name, robot in cell.robots.items()}
        self.dq = {name: (0.0,) * len(robot.joints) for name, robot in cell.robots.items()}
        self.phases = dict.fromkeys(cell.robots, Phase.READY)
        self.reasons: dict[str, ReasonCode | None] = dict.fromkeys(cell.robots)
        self.tools: dict[str, str] = {}
        self._due: dict[tuple[str, int], tuple[float, ...]] = {}
        self._last_due = dict.fromkeys(cell.robots, 0)
        self._alive: dict[str, asyncio.Event] = {name: asyncio.Event() for name in cell.robots}
        self._loop = asyncio.get_running_loop()
        links = guarded_links(cell)
        self._servers = {name: open_session(listen=[links[robot_server(name)]]) for name in cell.robots}
        self._sim = open_session(listen=[links[SIM]])
        self._envelopes = {
            session: Envelopes(service, cell.cell, tuple(cell.robots))
            for service, session in [
                (SIM, self._sim),
                *((robot_server(name), session) for name, session in self._servers.items()),
            ]
        }
        self._publishers: dict[str, Any] = {}
        self._subscribers = [
            # before requests, so that who has had one answered is known to be heard here too
            self._subscribe(topics.AUDIT_ENTRY.key(cell.cell), self._on_entry),
            self._subscribe(topics.REQUEST.key(cell.cell), self._on_request),
            self._subscribe(topics.COMMAND.key(cell.cell), self._on_command),
            self._subscribe(topics.HEALTH.key(cell.cell, service="hli"), self._on_health),
        ]

    async def turn(self, robot: str = "fr", cycles: int = 1) -> int:
        """Publish the states of the next cycles, each answered by a request; returns the last cycle."""
        for _ in range(cycles):
            self._begin_cycle(robot)
            self._alive[robot].clear()
            # until the HLI has found us what we publish reaches nobody
            while not self._alive[robot].is_set():
                self.publish_state(robot)
                try:
                    async with asyncio.timeout(0.05):
                        await self._alive[robot].wait()
                except TimeoutError:
                    continue
        return self.cycle

    async def run(self, robot: str = "fr") -> None:
        """Turn for ever, in the cell's cycle."""
        while True:
            self._begin_cycle(robot)
            self.publish_state(robot)
            await asyncio.sleep(self.cell.cycle_s)

    def publish_state(self, robot: str = "fr", **changes: Any) -> None:
        """Publish one state."""
        fields: dict[str, Any] = {"q_cmd": self.q_cmd[robot], "reason": self.reasons[robot]}
        fields["tool"] = self.tools.get(robot)
        if self.cell.gate.lookahead_cycles > 1:
            dq = self.dq[robot]
            fields |= {"dq": dq, "plan": Plan(dq=dq, brake_cycles=1, step=0 if any(dq) else 1)}
        fields |= changes
        state = server_state(robot, self.cycle, self.phases[robot], **fields)
        key = topics.SERVER_STATE.key(self.cell.cell, robot=robot)
        self._publish(self._servers[robot], key, state)

    def judge(self, request: Request) -> None:
        """Admit a request as it is."""
        robot, dq = request.robot, request.dq or ()
        goes = self._place(robot, request.cycle)
        verdict = Verdict(
            robot=robot,
            cycle=request.cycle,
            seq=request.seq,
            outcome=Outcome.ADMITTED,
            setpoint_cycle=goes,
            scale=1.0,
            dq=dq,
            time_to_stop_s=self.cell.cycle_s,
        )
        if self.cell.gate.lookahead_cycles > 1:
            self._due[robot, goes] = dq
        else:
            self._move(robot, dq)
        self.publish_from_sim(topics.GATE_VERDICT.key(self.cell.cell, robot=robot), verdict)

    def _place(self, robot: str, cycle: int) -> int:
        """The cycle that an increment goes into: behind all that is due, or as far ahead as may be."""
        ahead, last = self.cell.gate.lookahead_cycles, self._last_due[robot]
        if ahead == 1:
            return cycle + 1
        self._last_due[robot] = last + 1 if last >= self.cycle else self.cycle + ahead
        return self._last_due[robot]

    def _begin_cycle(self, robot: str) -> None:
        self.cycle += 1
        if self.cell.gate.lookahead_cycles > 1:
            self._move(robot, self._due.pop((robot, self.cycle), (0.0,) * len(self.q_cmd[robot])))

    def _move(self, robot: str, dq: tuple[float, ...]) -> None:
        moved = zip(self.q_cmd[robot], dq, strict=True)
        self.q_cmd[robot], self.dq[robot] = tuple(q + dq for q, dq in moved), dq

    def publish_from_sim(self, key: str, message: Message) -> None:
        """Publish as the SIM."""
        self._publish(self._sim, key, message)

    def publish_bytes(self, key: str, payload: bytes) -> None:
        """Publish what is no message, enclosed, as the SIM or as the Robot Server whose state it should be."""
        *_, robot, what = key.split("/")
        session = self._servers[robot] if what == "state" else self._sim
        session.put(key, self._envelopes[session].close(key, payload))

    def close(self) -> None:
        """Vanish."""
        while self._subscribers:
            self._subscribers.pop().undeclare()
        for session in (*self._servers.values(), self._sim):
            session.close()

    def _publish(self, session: Any, key: str, message: Message) -> None:
        if key not in self._publishers:
            self._publishers[key] = declare_publisher(session, key, self._envelopes[session])
        self._publishers[key].put(pack(message))

    def _subscribe(self, key: str, take: Callable[[bytes], None]) -> Any:
        def open_and_take(enclosed: bytes) -> None:
            # whoever it is for: an HLI is answered from its first message on
            self._envelopes[self._sim]._present[HLI] = sender_of(enclosed)
            take(message_in(enclosed))

        def put(sample: zenoh.Sample) -> None:
            if not self._loop.is_closed():
                self._loop.call_soon_threadsafe(open_and_take, sample.payload.to_bytes())

        return self._sim.declare_subscriber(key, zenoh.handlers.Callback(put, indirect=False))

    def _on_request(self, payload: bytes) -> None:
        request = unpack(Request, payload)
        self._alive[request.robot].set()
        if request.dq is None:
            return
        self.increments.put_nowait(request)
        if self.judges:
            self.judge(request)

    def _on_health(self, payload: bytes) -> None:
        self.health.put_nowait(unpack(Health, payload))

    def _on_entry(self, payload: bytes) -> None:
        self.entries.put_nowait(unpack(AuditEntry, payload))

    def _on_command(self, payload: bytes) -> None:
        command = unpack(Command, payload)
        self.commands.put_nowait(command)
        if self.obeys:
            reply = CommandReply(id=command.id, accepted=self.refuses is None, code=self.refuses)
            self.publish_from_sim(topics.COMMAND_REPLY.key(self.cell.cell), reply)
            if command.kind == "tool" and command.robot is not None and reply.accepted:
                self.tools[command.robot] = command.tool


@asynccontextmanager
async def guarded_peer(cell: CellDescription) -> AsyncIterator[GuardedPeer]:
    """A peer for the length of the block."""
    peer = GuardedPeer(cell)
    try:
        yield peer
    finally:
        peer.close()
