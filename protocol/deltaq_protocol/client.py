"""The client that a controller imports: connect, take a robot's lease, answer states with increments.

    async with connect("tcp/127.0.0.1:7447") as cell:
        async with cell.lease("fr") as robot:
            async for state in robot.states():
                verdict = await robot.move(dq)  # (n,) [rad or m] for one cycle; what was admitted comes back

Leaving a block, by any road, sends nothing more: the robot brakes to rest along a path that the gate has
certified.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

import msgpack
import numpy as np
import zenoh
from numpy.typing import ArrayLike

from deltaq_protocol import topics
from deltaq_protocol.codec import InvalidMessageError, from_map, unpack
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import (
    PROTOCOL_VERSION,
    ContactRequest,
    DescribeRequest,
    Description,
    Done,
    DryRunReply,
    DryRunRequest,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    ResetRequest,
    RobotState,
    RobotSummary,
    Status,
    StopRequest,
    Verdict,
)
from deltaq_protocol.newest import Newest
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_protocol.session import open_session
from deltaq_protocol.wire import Wire

M = TypeVar("M", bound=Message)

DEFAULT_ADDRESS = "tcp/127.0.0.1:7447"
_SILENCE_S = 1.0
"""Silence after which a reader of states asks whether the server is still there."""
_CONNECT_DEADLINE_S = 2.0
_VERDICTS_WAITING = 1024


class Cell:
    """A connection to a running cell; `connect` hands it out.

    Attributes:
        description: everything needed to model the cell: YAML, URDFs, limits.
        robots: joints, units and limits of each robot, by name.
        counters: messages of the server that could not be understood.
    """

    def __init__(self, wire: Wire, description: Description, client: str, token: str | None) -> None:
        self.description = description
        self.robots: dict[str, RobotSummary] = description.robots
        self.counters: Counter[str] = Counter()
        self._wire = wire
        self._client = client
        self._token = token
        self._newest: dict[str, Newest[RobotState]] = {name: Newest() for name in self.robots}
        self._verdict_listeners: set[Callable[[Verdict], None]] = set()
        for name in self.robots:
            wire.subscribe(topics.STATE.key(description.cell, robot=name), self._take_state, capacity=1)
        wire.subscribe(topics.VERDICT.key(description.cell), self._take_verdict, _VERDICTS_WAITING)

    def state(self, robot: str) -> RobotState | None:
        """The newest state of a robot; None before the first."""
        return self._newest[self._known(robot)].value

    async def states(self, robot: str) -> AsyncIterator[RobotState]:
        """States of a robot as they come, the newest only: whoever is slow skips.

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: the server is gone.
        """
        newest = self._newest[self._known(robot)]
        seen = 0
        while True:
            try:
                state = await newest.after(seen, _SILENCE_S)
            except TimeoutError:
                await self.status()  # raises if the server is gone; a robot that is offline is waited for
                continue
            seen = newest.version
            yield state

    async def verdicts(self, robot: str) -> AsyncIterator[Verdict]:
        """Every verdict on the increments of a robot, whoever sent them; the oldest are lost on the slow.

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: the server is gone.
        """
        self._known(robot)
        waiting: asyncio.Queue[Verdict] = asyncio.Queue(_VERDICTS_WAITING)

        def listen(verdict: Verdict) -> None:
            if verdict.robot == robot:
                if waiting.full():
                    waiting.get_nowait()
                waiting.put_nowait(verdict)

        self._verdict_listeners.add(listen)
        try:
            while True:
                try:
                    async with asyncio.timeout(_SILENCE_S):
                        verdict = await waiting.get()
                except TimeoutError:
                    await self.status()  # raises if the server is gone
                else:
                    yield verdict
        finally:
            self._verdict_listeners.discard(listen)

    async def stop(self) -> Done:
        """Bring every robot of the cell to rest; each is then held until it is reset.

        Raises:
            ServiceUnreachableError: no answer in time.
        """
        request = StopRequest(client=self._client)
        return unpack(Done, await self._wire.ask(topics.STOP.key(self.description.cell), request))

    async def reset(self, robot: str) -> Done:
        """Leave `held`.

        Raises:
            RefusedError: `cause_stands`, `not_at_rest`, or `not_permitted` without the operator's token.
            ServiceUnreachableError: no answer in time.
        """
        request = ResetRequest(robot=self._known(robot), client=self._client, token=self._token)
        return unpack(Done, await self._wire.ask(topics.RESET.key(self.description.cell), request))

    async def dry_run(self, robot: str, dq: ArrayLike) -> Verdict:
        """What the gate would say to an increment now; nothing moves.

        Args:
            robot: its name.
            dq: (n,) increment [rad or m].

        Raises:
            RefusedError: `bad_shape`, `not_ready`, or `superseded` for a second one in a cycle.
            ServiceUnreachableError: no answer in time.
        """
        key = topics.DRY_RUN.key(self.description.cell, robot=self._known(robot))
        request = DryRunRequest(robot=robot, dq=tuple(np.asarray(dq, dtype=float).tolist()))
        return unpack(DryRunReply, await self._wire.ask(key, request)).verdict

    async def allow_contact(self, contact: str, allowed: bool = True) -> Done:
        """Let bodies touch that a contact of the cell names, or forbid it again.

        Raises:
            RefusedError: the cell has no such contact, or `not_permitted` without the operator's token.
            ServiceUnreachableError: no answer in time.
        """
        request = ContactRequest(contact=contact, allowed=allowed, client=self._client, token=self._token)
        return unpack(Done, await self._wire.ask(topics.CONTACT.key(self.description.cell), request))

    async def status(self) -> Status:
        """The running cell: phases, leases, ages, counters.

        Raises:
            ServiceUnreachableError: no answer in time.
        """
        key = topics.STATUS.key(self.description.cell)
        return unpack(Status, await self._wire.ask(key, DescribeRequest()))

    @asynccontextmanager
    async def lease(
        self, robot: str, client: str | None = None, take: bool = False
    ) -> AsyncIterator[LeasedRobot]:
        """Hold the lease of a robot for the length of the block; it is renewed by itself.

        Args:
            robot: name of the robot.
            client: what others see as the holder's name; otherwise the name given to `connect`.
            take: take the lease from whoever holds it; it is on record.

        Raises:
            RefusedError: `lease_taken` by another client, `unknown_robot`, or `not_permitted` to take.
            ServiceUnreachableError: no answer in time.
        """
        action = LeaseAction.TAKE if take else LeaseAction.ACQUIRE
        request = LeaseRequest(
            robot=self._known(robot), action=action, client=client or self._client, token=self._token
        )
        key = topics.LEASE.key(self.description.cell, robot=robot)
        reply = unpack(LeaseReply, await self._wire.ask(key, request))
        if not reply.granted:
            raise _not_granted(reply)
        leased = LeasedRobot(
            self._wire,
            self.description.cell,
            robot,
            self.robots[robot],
            reply,
            self._newest[robot],
            lambda: self.states(robot),
        )
        self._verdict_listeners.add(leased.take_verdict)
        keeper = asyncio.create_task(leased.keep_lease())
        try:
            yield leased
        finally:
            keeper.cancel()
            self._verdict_listeners.discard(leased.take_verdict)
            await asyncio.shield(leased.release())

    def _known(self, robot: str) -> str:
        if robot not in self.robots:
            has = ", ".join(self.robots)
            raise RefusedError(ReasonCode.UNKNOWN_ROBOT, f"the cell has no robot {robot!r}", f"it has {has}")
        return robot

    def _take_state(self, sample: zenoh.Sample) -> None:
        state = self._decoded(RobotState, sample)
        if state is not None and state.robot in self._newest:
            self._newest[state.robot].put(state)

    def _take_verdict(self, sample: zenoh.Sample) -> None:
        if not self._verdict_listeners:
            return
        verdict = self._decoded(Verdict, sample)
        if verdict is not None:
            for listener in tuple(self._verdict_listeners):
                listener(verdict)

    def _decoded(self, message_type: type[M], sample: zenoh.Sample) -> M | None:
        try:
            return unpack(message_type, sample.payload.to_bytes())
        except InvalidMessageError:
            self.counters["malformed"] += 1
            return None


@asynccontextmanager
async def connect(
    address: str = DEFAULT_ADDRESS, client: str = "python", token: str | None = None
) -> AsyncIterator[Cell]:
    """Connect to a running cell for the length of the block.

    Args:
        address: where its HLI listens, e.g. `tcp/127.0.0.1:7447`.
        client: a name for others to see.
        token: the operator's token, where `reset` and taking a lease need one.

    Raises:
        ServiceUnreachableError: nobody answers there.
        RefusedError: `protocol_version`, if the server speaks another version.
    """
    session = await asyncio.to_thread(open_session, connect=[address], must_connect=True)
    wire = Wire(session, asyncio.get_running_loop())
    try:
        yield Cell(wire, await _described(wire, address), client, token)
    finally:
        await asyncio.to_thread(wire.close)


async def _described(wire: Wire, address: str) -> Description:
    """Ask for the description; in the first milliseconds of a connection the server's keys are not known yet."""
    loop = asyncio.get_running_loop()
    give_up_s = loop.time() + _CONNECT_DEADLINE_S
    while True:
        try:
            payload = await wire.ask(topics.DESCRIPTION.key("*"), DescribeRequest())
        except ServiceUnreachableError:
            if loop.time() >= give_up_s:
                raise ServiceUnreachableError(
                    f"{address} answers, but serves no cell; is it the address of an HLI (`hli` in the cell's YAML)?"
                ) from None
            await asyncio.sleep(0.01)
        else:
            return _of_our_version(payload)


def _of_our_version(payload: bytes) -> Description:
    # the version first: a description of another version may have other fields
    data = msgpack.unpackb(payload)
    theirs = data.get("protocol") if isinstance(data, dict) else None
    if theirs != PROTOCOL_VERSION:
        raise RefusedError(
            ReasonCode.PROTOCOL_VERSION,
            f"the server speaks protocol {theirs}, this client {PROTOCOL_VERSION}",
            "install the deltaq version that the server runs",
        )
    return from_map(Description, data)


def _not_granted(reply: LeaseReply) -> RefusedError:
    code = reply.code or ReasonCode.LEASE_TAKEN
    text = f"the lease of {reply.robot} was not granted: {EXPLANATIONS[code]}"
    if reply.holder is not None and reply.expires_s is not None:
        text += f"; {reply.holder} holds it for another {max(0.0, reply.expires_s):.1f} s unless renewed"
    hint = "wait for it, or take it (`take=True`)" if code is ReasonCode.LEASE_TAKEN else ""
    return RefusedError(code, text, hint)
