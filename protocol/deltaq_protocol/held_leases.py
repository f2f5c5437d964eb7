"""The leases of a client: each renewed while it is held, and given back when its block is left or the client ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from deltaq_protocol import topics
from deltaq_protocol.asking import Asking
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.given_token import CLIENT_TOKEN
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import Description, LeaseAction, LeaseReply, LeaseRequest
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_protocol.subscriptions import Subscriptions
from deltaq_protocol.wire import Wire


class HeldLeases:
    """Asks for leases, and keeps and returns those that were granted.

    Args:
        wire: to the server.
        description: of the cell.
        asking: asks with the client's role.
        heard: what the client hears of the robots.
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
        """`release` from where no loop runs any more."""
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
