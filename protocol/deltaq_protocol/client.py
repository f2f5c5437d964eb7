"""The client that a controller imports: connect, take a robot's lease, answer states with increments.

    async with connect("tcp/127.0.0.1:7447") as cell:
        async with cell.lease("fr") as robot:
            async for state in robot.states():
                verdict = await robot.move(dq)  # (n,) [rad or m] for one cycle; what was admitted comes back

When a block is left, for any reason, nothing more is sent: the robot brakes to rest along a path that the gate has
certified. In a notebook, `await connect(...).open()` and `await cell.close()` do the same; a lease has `open` and
`close`, too.

If the controller or its round trip takes longer than a cycle, or the cell has a lookahead, do not wait for verdicts:
    call `await robot.send(dq)` and read `robot.new_verdicts()`; `deltaq_protocol.in_flight` keeps account of
    increments in flight.
"""

import asyncio
import atexit
import contextlib
import os
import time
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import TypeVar

import msgpack
import numpy as np
from numpy.typing import ArrayLike

from deltaq_protocol import topics
from deltaq_protocol.certified.encryption import client_tls
from deltaq_protocol.codec import from_map
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.given_token import CLIENT_TOKEN
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import (
    PROTOCOL_VERSION,
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
    ResetRequest,
    RobotState,
    RobotSummary,
    Status,
    StopRequest,
    Verdict,
    ViewReply,
    ViewRequest,
    ViewTarget,
)
from deltaq_protocol.opening import Opening
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_protocol.role_prover import RoleProver, role_prover
from deltaq_protocol.session import open_session
from deltaq_protocol.subscriptions import StateHolder, Subscriptions
from deltaq_protocol.wire import LOOK_AGAIN_S, Asking, Wire

# The first question of every client: which cell is served here, and in which version?

_CONNECT_DEADLINE_S = 3.0


async def described(wire: Wire, address: str) -> Description:
    """Ask for the description.

    Args:
        wire: a connection that has just been opened.
        address: of the server, for messages.

    Raises:
        ServiceUnreachableError: no server of a cell answers there.
        RefusedError: `protocol_version`, if the server speaks another version.
    """
    loop = asyncio.get_running_loop()
    give_up_s = loop.time() + _CONNECT_DEADLINE_S
    while (left_s := give_up_s - loop.time()) > 0.0:
        # the question changes nothing, so it may be repeated: a new link may not yet know the services at its other
        # end
        with contextlib.suppress(ServiceUnreachableError):
            return _of_our_version(
                await wire.ask(topics.DESCRIPTION, "*", DescribeRequest(), deadline_s=left_s)
            )
        await asyncio.sleep(LOOK_AGAIN_S)
    raise ServiceUnreachableError(
        f"{address} answers, but serves no cell; is it the address of an HLI (`hli` in the cell's YAML)?"
    )


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


DEFAULT_ADDRESS = "tcp/127.0.0.1:7447"
_ROUND_TRIPS = 5


class Cell:
    """A connection to a running cell; `connect` returns it.

    Attributes:
        robots: joints, units and limits of each robot, by name.
        counters: messages of the server that could not be understood.
    """

    def __init__(self, wire: Wire, description: Description, client: str, role: RoleProver | None) -> None:
        self._description = description
        self.robots: dict[str, RobotSummary] = description.robots
        self._heard = Subscriptions(wire, description.cell, description.robots, self.ask_whether_there)
        self.counters: Counter[str] = self._heard.counters
        self._wire = wire
        self._client = client
        self._asking = Asking(wire, description.cell, role)
        self._leases = HeldLeases(wire, description, self._asking, self._heard)

    @property
    def description(self) -> Description:
        """Everything needed to model the cell: YAML, URDFs, limits, and the tools that the robots have now."""
        if self._description.coupled:
            states = {name: self.state(name) for name in self._description.coupled}
            coupled = {name: state.coupled for name, state in states.items() if state is not None}
            if not coupled.items() <= self._description.coupled.items():
                coupled = self._description.coupled | coupled
                self._description = self._description.model_copy(update={"coupled": coupled})
        return self._description

    def state(self, robot: str) -> RobotState | None:
        """The newest state of a robot; None before the first."""
        return self._heard.newest(robot).value

    def newest(self, robot: str) -> StateHolder:
        """The holder of the newest state of a robot, for a reader in another thread."""
        return self._heard.newest(robot)

    def states(self, robot: str) -> AsyncIterator[RobotState]:
        """States of a robot as they come, the newest only: a slow reader skips states.

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: the server is gone.
        """
        return self._heard.states(robot)

    def verdicts(self, robot: str) -> AsyncIterator[Verdict]:
        """Every verdict on the increments of a robot, from any client; a slow reader loses the oldest.

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: the server is gone.
        """
        return self._heard.verdicts(robot)

    async def stop(self) -> Done:
        """Bring every robot of the cell to rest; each is held until it is reset. Returns when all states show it.

        Raises:
            RefusedError: `unreachable`, if not all robots have shown it in time; the stop was sent nevertheless.
            ServiceUnreachableError: no answer in time.
        """
        request = StopRequest(client=self._client)
        return await self._asking.ask(Done, topics.STOP, request)

    async def reset(self, robot: str) -> Done:
        """Leave `held`.

        Raises:
            RefusedError: `cause_stands`, `not_at_rest`, `not_permitted` without the operator's token, or `unreachable`
                if the robot has not shown it in time.
            ServiceUnreachableError: no answer in time.
        """
        request = ResetRequest(robot=self._heard.known(robot), client=self._client)
        return await self._asking.ask_with_role(Done, topics.RESET, request)

    async def dry_run(self, robot: str, dq: ArrayLike) -> Verdict:
        """The gate's verdict on an increment in the present state; nothing moves.

        Args:
            robot: its name.
            dq: (n,) increment [rad or m].

        Raises:
            RefusedError: `bad_shape`, `not_ready`, or `superseded` for a second one in a cycle.
            ServiceUnreachableError: no answer in time.
        """
        request = DryRunRequest(
            robot=self._heard.known(robot), dq=tuple(np.asarray(dq, dtype=float).tolist())
        )
        return (await self._asking.ask(DryRunReply, topics.DRY_RUN, request, robot)).verdict

    async def io(self, robot: str) -> IoReply:
        """Digital outputs and inputs of a robot; only its lease sets them (`LeasedRobot.io`).

        Raises:
            RefusedError: the cell has no such robot.
            ServiceUnreachableError: no answer in time.
        """
        request = IoRequest(robot=self._heard.known(robot), outputs={})
        return await self._asking.ask(IoReply, topics.IO, request, robot)

    async def view(
        self,
        robot: str,
        distance_m: float | None = None,
        leader: str | None = None,
        aim_offset_m: ArrayLike | None = None,
        focus_m: ArrayLike | None = None,
        targets: Sequence[ViewTarget] | None = None,
    ) -> ViewReply:
        """Ask the camera follower of a robot for another view; omitted values do not change.

        Args:
            robot: the robot that carries the camera.
            distance_m: from the lens to the target [m].
            leader: robot whose tool the camera looks at.
            aim_offset_m: (3,) the target in the frame of that tool [m].
            focus_m: (3,) a fixed target in the world [m].
            targets: in place of the three above: the camera looks at the first of them that it can see.

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
        asked = None if targets is None else [target.model_dump(exclude_none=True) for target in targets]
        fields = {
            "robot": self._heard.known(robot),
            "client": self._client,
            **wish,
            **points,
            "targets": asked,
        }
        request = from_map(ViewRequest, fields)
        return await self._asking.ask_with_role(ViewReply, topics.VIEW, request, robot)

    async def allow_contact(self, contact: str, allowed: bool = True) -> Done:
        """Let bodies touch that a contact of the cell names, or forbid it again.

        Raises:
            RefusedError: the cell has no such contact, or `not_permitted` without the operator's token.
            ServiceUnreachableError: no answer in time.
        """
        request = ContactRequest(contact=contact, allowed=allowed, client=self._client)
        return await self._asking.ask_with_role(Done, topics.CONTACT, request)

    async def status(self) -> Status:
        """The running cell: phases, leases, ages, counters.

        Raises:
            ServiceUnreachableError: no answer in time.
        """
        return await self._asking.ask(Status, topics.STATUS, DescribeRequest())

    async def ask_whether_there(self) -> None:
        """Ask the server a harmless question after a silence, to see whether it is there.

        A machine that stalls for longer than the link's lease loses the link and its first question. So an
        unanswered question is asked once more.

        Raises:
            ServiceUnreachableError: neither question was answered in time.
        """
        try:
            await self.status()
        except ServiceUnreachableError:
            await self.status()

    async def round_trip_s(self) -> float:
        """The shortest of five ways to the server and back [s]: a busy machine only adds to it, or loses some.

        Raises:
            ServiceUnreachableError: no answer in time to any of them.
        """
        took_s: list[float] = []
        unanswered: ServiceUnreachableError | None = None
        for _ in range(_ROUND_TRIPS):
            began_s = time.perf_counter()
            try:
                await self.status()
            except ServiceUnreachableError as error:
                unanswered = error
            else:
                took_s.append(time.perf_counter() - began_s)
        if unanswered is not None and not took_s:
            raise unanswered
        return min(took_s)

    def lease(
        self, robot: str, client: str | None = None, take: bool = False, playout: bool = False
    ) -> Opening[LeasedRobot]:
        """Hold the lease of a robot for the length of a block, or from `open` to `close`; it is renewed automatically.

        Args:
            robot: name of the robot.
            client: the holder's name for others; by default the name given to `connect`.
            take: take the lease from its present holder; this is logged.
            playout: use a jitter buffer: increments that come unevenly wait in the HLI, so that each cycle has one.
                For a controller that sends with `send` and whose round trip (`round_trip_s`) takes longer than a
                cycle.

        Raises:
            RefusedError: `lease_taken` by another client, `unknown_robot`, or `not_permitted` to take.
            ServiceUnreachableError: no answer in time.
        """
        return Opening(self._leases.held(robot, client or self._client, take, playout))

    async def close(self) -> None:
        """Give back every lease and end the connection; leaving the block of `connect` does so."""
        await self._leases.release()
        try:
            await asyncio.to_thread(self._wire.close)
        except RuntimeError:  # the interpreter ends: no new thread can start
            self._wire.close()

    def close_now(self) -> None:
        """`close`, for a loop that ended before it could be awaited: the interpreter is about to end."""
        self._leases.release_now()
        self._wire.close()


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
        address: endpoint at which the HLI listens, e.g. `tcp/127.0.0.1:7447`.
        client: name that others see.
        token: the operator's or the controller's, if the server asks for one; it is not sent. None: the token in
            the environment variable `DELTAQ_CLIENT_TOKEN`, or in the file that `DELTAQ_CLIENT_TOKEN_FILE` names.
        identity: folder of an operator's or a controller's identity, which is preferred to a token; None: the folder
            that the environment variable `DELTAQ_CLIENT_IDENTITY` names, if any. An address of `tls/` needs one.

    Files that the environment names are read, and errors in them raised, when a role is needed; a stop needs none.

    Raises:
        IdentityError: the identity is missing, not valid, or a service's, or an encrypted address needs one.
        ServiceUnreachableError: no HLI answers at the address.
        RefusedError: `protocol_version`, if the server speaks another version.
    """
    return connected(Cell, address, client, token, identity)


C = TypeVar("C", bound=Cell)


def connected(
    cell_class: type[C],
    address: str,
    client: str,
    token: str | None = None,
    identity: str | os.PathLike[str] | None = None,
) -> Opening[C]:
    """`connect` with a cell of another class."""
    return Opening(_connected(cell_class, address, client, role_prover(token, identity), identity))


@asynccontextmanager
async def _connected(
    cell_class: type[C],
    address: str,
    client: str,
    role: RoleProver | None,
    identity: str | os.PathLike[str] | None,
) -> AsyncIterator[C]:
    tls = client_tls(address, identity)
    session = await asyncio.to_thread(open_session, connect=[address], must_connect=True, tls=tls)
    wire = Wire(session, asyncio.get_running_loop())
    try:
        cell = cell_class(wire, await described(wire, address), client, role)
    except BaseException:
        await asyncio.to_thread(wire.close)
        raise
    atexit.register(cell.close_now)
    try:
        yield cell
    finally:
        await cell.close()
        atexit.unregister(cell.close_now)


class HeldLeases:
    """Asks for leases, and keeps and returns those that were granted.

    Args:
        wire: to the server.
        description: of the cell.
        asking: asks with the client's role.
        heard: the newest states and verdicts of the robots.
    """

    def __init__(self, wire: Wire, description: Description, asking: Asking, heard: Subscriptions) -> None:
        self._wire = wire
        self._description = description
        self._asking = asking
        self._heard = heard
        self._held: set[LeasedRobot] = set()

    @asynccontextmanager
    async def held(self, robot: str, client: str, take: bool, playout: bool) -> AsyncIterator[LeasedRobot]:
        """Hold the lease of a robot for the length of a block; see `Cell.lease`."""
        action = LeaseAction.TAKE if take else LeaseAction.ACQUIRE
        robot = self._heard.known(robot)
        request = LeaseRequest(robot=robot, action=action, client=client, playout=playout)
        listeners = self._heard.listeners(robot)  # before the lease, so that no verdict on it is missed
        reply = await self._asking.ask_with_role(LeaseReply, topics.LEASE, request, robot)
        if not reply.granted:
            raise _not_granted(reply)
        leased = LeasedRobot(
            self._wire,
            self._description.cell,
            robot,
            self._description.robots[robot],
            reply,
            self._heard.newest(robot),
            lambda: self._heard.states(robot),
            playout,
        )
        listeners.add(leased.take_verdict)
        self._held.add(leased)
        keeper = asyncio.create_task(leased.lease.keep())
        try:
            yield leased
        finally:
            keeper.cancel()
            listeners.discard(leased.take_verdict)
            await asyncio.shield(leased.release())
            self._held.discard(leased)

    async def release(self) -> None:
        """Give all of them back."""
        await asyncio.gather(*(leased.release() for leased in self._held))

    def release_now(self) -> None:
        """`release` for a caller without a running event loop."""
        for leased in self._held:
            leased.release_now()


def _not_granted(reply: LeaseReply) -> RefusedError:
    code = reply.code or ReasonCode.LEASE_TAKEN
    text = f"the lease of {reply.robot} was not granted: {EXPLANATIONS[code]}"
    if reply.holder is not None and reply.expires_s is not None:
        text += f"; {reply.holder} holds it for another {max(0.0, reply.expires_s):.1f} s unless renewed"
    return RefusedError(code, text, _HINTS.get(code, ""))


_HINTS = {
    ReasonCode.LEASE_TAKEN: "wait for it, or take it (`take=True`)",
    ReasonCode.NOT_PERMITTED: f"give the controller's token, or the operator's to take it from its holder: "
    f"`connect(token=...)`, {CLIENT_TOKEN}, or the file that {CLIENT_TOKEN}_FILE names",
}
