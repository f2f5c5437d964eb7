"""The client that a controller imports: connect, take a robot's lease, answer states with increments.

    async with connect("tcp/127.0.0.1:7447") as cell:
        async with cell.lease("fr") as robot:
            async for state in robot.states():
                verdict = await robot.move(dq)  # (n,) [rad or m] for one cycle; what was admitted comes back

However a block is left, nothing more is sent: the robot brakes to rest along a path that the gate has
certified. In a notebook, `await connect(...).open()` and `await cell.close()` do the same; a lease has `open`
and `close`, too.

A controller that is slower than a cycle, or farther away, does not wait, nor does any in a cell with a lookahead: it
calls `await robot.send(dq)` and reads `robot.new_verdicts()`; `deltaq_protocol.in_flight` says what is on its way.
"""

from __future__ import annotations

import asyncio
import atexit
import os
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
import zenoh
from numpy.typing import ArrayLike

from deltaq_protocol import topics
from deltaq_protocol.certified.names import CLIENT_IDENTITY
from deltaq_protocol.certified.prover import identity_prover
from deltaq_protocol.codec import InvalidMessageError, from_map, unpack
from deltaq_protocol.describing import described
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import (
    Challenge,
    ChallengeRequest,
    ContactRequest,
    DescribeRequest,
    Description,
    Done,
    DryRunReply,
    DryRunRequest,
    IoReply,
    IoRequest,
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
    ViewReply,
    ViewRequest,
)
from deltaq_protocol.newest import Newest
from deltaq_protocol.opening import Opening
from deltaq_protocol.proof import Prover
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Topic
from deltaq_protocol.wire import Wire

M = TypeVar("M", bound=Message)
StateHolder = Newest[zenoh.Sample, RobotState]

DEFAULT_ADDRESS = "tcp/127.0.0.1:7447"
TOKEN_VARIABLE = "DELTAQ_CLIENT_TOKEN"
"""Environment variable: the token of a client that is given none by its program."""
SILENCE_S = 1.0
"""Silence after which a reader of states asks whether the server is still there."""
_VERDICTS_WAITING = 1024
_ROUND_TRIPS = 5


class RoleProver(Protocol):
    """Shows a client's role, and with an identity its name."""

    def prove(self, key: str, message: bytes, nonce: bytes) -> bytes:
        """A proof for a message under a zenoh key, in answer to a challenge."""


class Cell:
    """A connection to a running cell; `connect` returns it.

    Attributes:
        description: everything needed to model the cell: YAML, URDFs, limits.
        robots: joints, units and limits of each robot, by name.
        counters: messages of the server that could not be understood.
    """

    def __init__(self, wire: Wire, description: Description, client: str, role: RoleProver | None) -> None:
        self.description = description
        self.robots: dict[str, RobotSummary] = description.robots
        self.counters: Counter[str] = Counter()
        self._wire = wire
        self._client = client
        self._role = role
        self._newest: dict[str, StateHolder] = {name: self._subscribed(name) for name in self.robots}
        self._verdict_listeners: dict[str, set[Callable[[Verdict], None]]] = {}
        self._leases: set[LeasedRobot] = set()

    def state(self, robot: str) -> RobotState | None:
        """The newest state of a robot; None before the first."""
        return self._newest[self._known(robot)].value

    def newest(self, robot: str) -> StateHolder:
        """The holder of the newest state of a robot, for a reader in another thread."""
        return self._newest[self._known(robot)]

    async def states(self, robot: str) -> AsyncIterator[RobotState]:
        """States of a robot as they come, the newest only: a slow reader skips states.

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: the server is gone.
        """
        newest = self._newest[self._known(robot)]
        seen = 0
        while True:
            try:
                state, seen = await newest.after(seen, SILENCE_S)
            except TimeoutError:
                await self.status()  # raises if the server is gone; a robot that is offline is waited for
                continue
            yield state

    async def verdicts(self, robot: str) -> AsyncIterator[Verdict]:
        """Every verdict on the increments of a robot, whoever sent them; a slow reader loses the oldest.

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: the server is gone.
        """
        self._known(robot)
        waiting: asyncio.Queue[Verdict] = asyncio.Queue(_VERDICTS_WAITING)

        def listen(verdict: Verdict) -> None:
            if waiting.full():
                waiting.get_nowait()
            waiting.put_nowait(verdict)

        listeners = self._listeners(robot)
        listeners.add(listen)
        try:
            while True:
                try:
                    async with asyncio.timeout(SILENCE_S):
                        verdict = await waiting.get()
                except TimeoutError:
                    await self.status()  # raises if the server is gone
                else:
                    yield verdict
        finally:
            listeners.discard(listen)

    async def stop(self) -> Done:
        """Bring every robot of the cell to rest; each is held until it is reset, and has shown so when this returns.

        Raises:
            RefusedError: `unreachable`, if not all of them have shown it in time; they were told all the same.
            ServiceUnreachableError: no answer in time.
        """
        request = StopRequest(client=self._client)
        return unpack(Done, await self._wire.ask(topics.STOP, self.description.cell, request))

    async def reset(self, robot: str) -> Done:
        """Leave `held`.

        Raises:
            RefusedError: `cause_stands`, `not_at_rest`, `not_permitted` without the operator's token, or `unreachable`
                if the robot has not shown it in time.
            ServiceUnreachableError: no answer in time.
        """
        request = ResetRequest(robot=self._known(robot), client=self._client)
        return unpack(Done, await self._ask_with_role(topics.RESET, request))

    async def dry_run(self, robot: str, dq: ArrayLike) -> Verdict:
        """The gate's verdict on an increment if it came now; nothing moves.

        Args:
            robot: its name.
            dq: (n,) increment [rad or m].

        Raises:
            RefusedError: `bad_shape`, `not_ready`, or `superseded` for a second one in a cycle.
            ServiceUnreachableError: no answer in time.
        """
        request = DryRunRequest(robot=self._known(robot), dq=tuple(np.asarray(dq, dtype=float).tolist()))
        payload = await self._wire.ask(topics.DRY_RUN, self.description.cell, request, robot)
        return unpack(DryRunReply, payload).verdict

    async def io(self, robot: str) -> IoReply:
        """Digital outputs and inputs of a robot; only its lease sets them (`LeasedRobot.io`).

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: no answer in time.
        """
        request = IoRequest(robot=self._known(robot), outputs={})
        return unpack(IoReply, await self._wire.ask(topics.IO, self.description.cell, request, robot))

    async def view(
        self,
        robot: str,
        distance_m: float | None = None,
        leader: str | None = None,
        aim_offset_m: ArrayLike | None = None,
        focus_m: ArrayLike | None = None,
    ) -> ViewReply:
        """Ask whoever follows with a robot's camera for another view; what is not given stays as it is.

        Args:
            robot: that carries the camera.
            distance_m: from the lens to the target [m].
            leader: robot whose tool is looked at.
            aim_offset_m: (3,) the target in the frame of that tool [m].
            focus_m: (3,) a target that stands still, in the world [m].

        Raises:
            RefusedError: the robot has no camera, there is no such leader, or `not_permitted` without a
                controller's token.
            InvalidMessageError: a value is beyond its bounds.
            ServiceUnreachableError: no answer in time.
        """
        wish = {"distance_m": distance_m, "leader": leader}
        points = {
            name: np.asarray(point, dtype=float).tolist()
            for name, point in (("aim_offset_m", aim_offset_m), ("focus_m", focus_m))
            if point is not None
        }
        fields = {"robot": self._known(robot), "client": self._client, **wish, **points}
        request = from_map(ViewRequest, fields)
        return unpack(ViewReply, await self._ask_with_role(topics.VIEW, request, robot))

    async def allow_contact(self, contact: str, allowed: bool = True) -> Done:
        """Let bodies touch that a contact of the cell names, or forbid it again.

        Raises:
            RefusedError: the cell has no such contact, or `not_permitted` without the operator's token.
            ServiceUnreachableError: no answer in time.
        """
        request = ContactRequest(contact=contact, allowed=allowed, client=self._client)
        return unpack(Done, await self._ask_with_role(topics.CONTACT, request))

    async def status(self) -> Status:
        """The running cell: phases, leases, ages, counters.

        Raises:
            ServiceUnreachableError: no answer in time.
        """
        payload = await self._wire.ask(topics.STATUS, self.description.cell, DescribeRequest())
        return unpack(Status, payload)

    async def round_trip_s(self) -> float:
        """The shortest of five ways to the server and back [s]: a busy machine only adds to it.

        Raises:
            ServiceUnreachableError: no answer in time.
        """
        took_s = []
        for _ in range(_ROUND_TRIPS):
            began_s = time.perf_counter()
            await self.status()
            took_s.append(time.perf_counter() - began_s)
        return min(took_s)

    def lease(
        self, robot: str, client: str | None = None, take: bool = False, playout: bool = False
    ) -> Opening[LeasedRobot]:
        """Hold the lease of a robot for the length of a block, or from `open` to `close`; it is renewed automatically.

        Args:
            robot: name of the robot.
            client: what others see as the holder's name; otherwise the name given to `connect`.
            take: take the lease from whoever holds it; this is logged.
            playout: for a controller farther away than a cycle (`round_trip_s`), which sends with `send`: its
                increments wait in the HLI, so that each cycle has one though they come unevenly.

        Raises:
            RefusedError: `lease_taken` by another client, `unknown_robot`, or `not_permitted` to take.
            ServiceUnreachableError: no answer in time.
        """
        return Opening(self._leased(robot, client, take, playout))

    @asynccontextmanager
    async def _leased(
        self, robot: str, client: str | None, take: bool, playout: bool
    ) -> AsyncIterator[LeasedRobot]:
        action = LeaseAction.TAKE if take else LeaseAction.ACQUIRE
        holder = client or self._client
        request = LeaseRequest(robot=self._known(robot), action=action, client=holder, playout=playout)
        listeners = self._listeners(robot)  # before the lease, so that no verdict on it is missed
        payload = await self._ask_with_role(topics.LEASE, request, robot)
        reply = unpack(LeaseReply, payload)
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
            playout,
        )
        listeners.add(leased.take_verdict)
        self._leases.add(leased)
        keeper = asyncio.create_task(leased.lease.keep())
        try:
            yield leased
        finally:
            keeper.cancel()
            listeners.discard(leased.take_verdict)
            await asyncio.shield(leased.release())
            self._leases.discard(leased)

    async def close(self) -> None:
        """Give back every lease and end the connection; leaving the block of `connect` does so."""
        await asyncio.gather(*(leased.release() for leased in self._leases))
        try:
            await asyncio.to_thread(self._wire.close)
        except RuntimeError:  # the interpreter ends: no new thread can start
            self._wire.close()

    def close_now(self) -> None:
        """`close` for a loop that has ended without it: the interpreter is about to end."""
        for leased in self._leases:
            leased.release_now()
        self._wire.close()

    async def _ask_with_role(self, topic: Topic, request: Message, robot: str = "") -> bytes:
        """Ask for what a role may; the token or identity, where there is one, answers a challenge and is not sent."""
        cell, prove = self.description.cell, None
        if self._role is not None:
            asked = await self._wire.ask(topics.CHALLENGE, cell, ChallengeRequest())
            nonce = bytes.fromhex(unpack(Challenge, asked).challenge)
            prove = partial(self._role.prove, nonce=nonce)
        return await self._wire.ask(topic, cell, request, robot, prove=prove)

    def _known(self, robot: str) -> str:
        if robot not in self.robots:
            has = ", ".join(self.robots)
            raise RefusedError(ReasonCode.UNKNOWN_ROBOT, f"the cell has no robot {robot!r}", f"it has {has}")
        return robot

    def _subscribed(self, robot: str) -> StateHolder:
        """The newest state of a robot; no other is decoded, and none that nobody reads."""

        def state(sample: zenoh.Sample) -> RobotState | None:
            state = self._decoded(RobotState, sample)
            return state if state is not None and state.robot == robot else None

        newest: StateHolder = Newest(asyncio.get_running_loop(), state)
        self._wire.subscribe_newest(topics.STATE.key(self.description.cell, robot=robot), newest)
        return newest

    def _listeners(self, robot: str) -> set[Callable[[Verdict], None]]:
        """Those that listen to the verdicts on a robot, which are subscribed to from the first one on."""
        if robot not in self._verdict_listeners:
            self._verdict_listeners[robot] = set()
            key = topics.VERDICT.key(self.description.cell, robot=robot)
            self._wire.subscribe(key, partial(self._take_verdict, robot), _VERDICTS_WAITING)
        return self._verdict_listeners[robot]

    def _take_verdict(self, robot: str, sample: zenoh.Sample) -> None:
        listeners = self._verdict_listeners[robot]
        if not listeners:
            return
        verdict = self._decoded(Verdict, sample)
        if verdict is not None and verdict.robot == robot:
            for listener in tuple(listeners):
                listener(verdict)

    def _decoded(self, message_type: type[M], sample: zenoh.Sample) -> M | None:
        try:
            return unpack(message_type, sample.payload.to_bytes())
        except InvalidMessageError:
            self.counters["malformed"] += 1
            return None


def connect(
    address: str = DEFAULT_ADDRESS,
    client: str = "python",
    token: str | None = None,
    identity: str | os.PathLike[str] | None = None,
) -> Opening[Cell]:
    """Connect to a running cell for the length of a block, or from `open` to `close`.

    A client that is not closed is disconnected when the loop or the interpreter ends: its leases are released, and its
    robots come to rest.

    Args:
        address: where its HLI listens, e.g. `tcp/127.0.0.1:7447`.
        client: name that others see.
        token: the operator's or the controller's, where the server asks for one; it is not sent. None: what the
            environment holds in `DELTAQ_CLIENT_TOKEN`, if anything.
        identity: folder of an operator's or a controller's identity, which goes before a token; None: what the
            environment names in `DELTAQ_CLIENT_IDENTITY`, if anything.

    Raises:
        IdentityError: the identity is missing, not valid, or a service's.
        ServiceUnreachableError: nobody answers there.
        RefusedError: `protocol_version`, if the server speaks another version.
    """
    return Opening(_connected(address, client, _role_prover(token, identity)))


def _role_prover(token: str | None, identity: str | os.PathLike[str] | None) -> RoleProver | None:
    """What shows a client's role; None: nothing does."""
    if folder := identity or os.environ.get(CLIENT_IDENTITY):
        return identity_prover(Path(folder))
    known = token or os.environ.get(TOKEN_VARIABLE)
    return Prover(known) if known else None


@asynccontextmanager
async def _connected(address: str, client: str, role: RoleProver | None) -> AsyncIterator[Cell]:
    session = await asyncio.to_thread(open_session, connect=[address], must_connect=True)
    wire = Wire(session, asyncio.get_running_loop())
    try:
        cell = Cell(wire, await described(wire, address), client, role)
    except BaseException:
        await asyncio.to_thread(wire.close)
        raise
    atexit.register(cell.close_now)
    try:
        yield cell
    finally:
        await cell.close()
        atexit.unregister(cell.close_now)


def _not_granted(reply: LeaseReply) -> RefusedError:
    code = reply.code or ReasonCode.LEASE_TAKEN
    text = f"the lease of {reply.robot} was not granted: {EXPLANATIONS[code]}"
    if reply.holder is not None and reply.expires_s is not None:
        text += f"; {reply.holder} holds it for another {max(0.0, reply.expires_s):.1f} s unless renewed"
    hint = "wait for it, or take it (`take=True`)" if code is ReasonCode.LEASE_TAKEN else ""
    return RefusedError(code, text, hint)
