"""A held lease: renewed while its holder runs; a lost lease does not come back."""

import asyncio

from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.errors import DeltaqError, RefusedError
from deltaq_protocol.messages import LeaseAction, LeaseReply, LeaseRequest
from deltaq_protocol.proof import Prover
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.wire import Wire

_RENEWALS_A_LEASE = 4


class HeldLease:
    """A client's lease of one robot.

    Args:
        wire: to the server.
        cell: name of the cell.
        robot: name of the robot.
        granted: the reply that granted it.

    Attributes:
        prover: shows the server that a message is the holder's.
    """

    def __init__(self, wire: Wire, cell: str, robot: str, granted: LeaseReply) -> None:
        self.prover = Prover(granted.lease or "")
        self._wire = wire
        self._cell = cell
        self._robot = robot
        self._lease_s = granted.expires_s or 0.0
        self._lost: DeltaqError | None = None

    def check(self) -> None:
        """Raise the error by which the lease was lost, if it was; callable from any thread."""
        if self._lost is not None:
            raise self._lost

    async def keep(self) -> None:
        """Renew the lease until it is lost."""
        loop = asyncio.get_running_loop()
        expires_s = loop.time() + self._lease_s
        while self._lost is None:
            await asyncio.sleep(self._lease_s / _RENEWALS_A_LEASE)
            asked_s = loop.time()
            try:
                await self.renew()
                expires_s = asked_s + self._lease_s
            except RefusedError as error:
                self._lost = self._lost or error
            except DeltaqError as error:
                if loop.time() >= expires_s:
                    self._lost = error

    async def renew(self) -> None:
        """Renew the lease now.

        Raises:
            RefusedError: it was lost.
            ServiceUnreachableError: no answer in time.
        """
        reply = await self._ask(LeaseAction.RENEW)
        if not reply.granted:
            now = f"{reply.holder} holds it now" if reply.holder else "it has run out"
            self._lost = RefusedError(
                ReasonCode.LEASE_NOT_HELD, f"the lease of {self._robot} was lost: {now}", "acquire it again"
            )
            raise self._lost

    def end(self) -> None:
        """Stop using the lease, without telling the server; `release` does that."""
        self._lost = RefusedError(ReasonCode.LEASE_NOT_HELD, f"the lease of {self._robot} was released")

    async def release(self) -> None:
        """Release the lease at the server.

        Raises:
            DeltaqError: the server cannot be reached.
        """
        await self._ask(LeaseAction.RELEASE)

    def release_now(self) -> None:
        """`release` for a caller without a running event loop."""
        request = self._request(LeaseAction.RELEASE)
        self._wire.ask_now(topics.LEASE, self._cell, request, self._robot, self.prover.prove_next)

    async def _ask(self, action: LeaseAction) -> LeaseReply:
        request, prove = self._request(action), self.prover.prove_next
        payload = await self._wire.ask(topics.LEASE, self._cell, request, self._robot, prove=prove)
        return unpack(LeaseReply, payload)

    def _request(self, action: LeaseAction) -> LeaseRequest:
        return LeaseRequest(robot=self._robot, action=action)
