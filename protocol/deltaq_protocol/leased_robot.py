"""A robot that this client may move, as long as it holds the lease."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Mapping

import zenoh

from deltaq_protocol import topics
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import (
    Increment,
    IoReply,
    IoRequest,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    RobotState,
    RobotSummary,
    Verdict,
)
from deltaq_protocol.newest import Newest
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.wire import Wire

VERDICT_DEADLINE_S = 0.5
"""Dozens of cycles: a verdict that has not come by then will not come."""
_RENEWALS_A_LEASE = 4


class LeasedRobot:
    """A robot whose lease this client holds; `Cell.lease` hands it out and keeps the lease renewed.

    Attributes:
        name: of the robot.
        summary: its joints, units and limits.
    """

    def __init__(
        self,
        wire: Wire,
        cell: str,
        name: str,
        summary: RobotSummary,
        granted: LeaseReply,
        newest: Newest[RobotState],
        states: Callable[[], AsyncIterator[RobotState]],
    ) -> None:
        self.name = name
        self.summary = summary
        self._wire = wire
        self._cell = cell
        self._token = granted.lease
        self._lease_s = granted.expires_s or 0.0
        self._states = states
        self._newest = newest
        self._publisher = wire.publisher(topics.INCREMENT.key(cell, robot=name))
        self._seq = 0
        self._awaited: dict[int, asyncio.Queue[Verdict]] = {}
        self._lost: DeltaqError | None = None
        self._is_released = False

    @property
    def state(self) -> RobotState | None:
        """The newest state; None before the first."""
        return self._newest.value

    async def states(self) -> AsyncIterator[RobotState]:
        """States as they come, the newest only: whoever is slow skips.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
        """
        async for state in self._states():
            self._check_lease()
            yield state

    async def move(self, dq: Iterable[float]) -> Verdict:
        """Ask for an increment in answer to the newest state, and wait for what becomes of it.

        Args:
            dq: (n,) increment over one cycle [rad or m].

        Returns:
            The verdict. Its `dq` is what was admitted, which may be less than was asked for; a request that
            was refused has the outcome `refused`, reasons, and no `dq`.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone, or gave no verdict in time.
        """
        self._check_lease()
        try:
            state = self._newest.value or await self._newest.after(0, VERDICT_DEADLINE_S)
        except TimeoutError:
            raise ServiceUnreachableError(
                f"no state of {self.name} within {VERDICT_DEADLINE_S:g} s; "
                "is its Robot Server up (`deltaq status`)?"
            ) from None
        self._seq += 1
        # not validated here: the server judges, so that there is one truth about what is refused
        increment = Increment.model_construct(
            robot=self.name,
            seq=self._seq,
            cycle=state.cycle,
            dq=tuple(float(element) for element in dq),
            lease=self._token,
        )
        verdicts = self._awaited[self._seq] = asyncio.Queue()
        try:
            self._publisher.put(pack(increment))
            async with asyncio.timeout(VERDICT_DEADLINE_S):
                while True:
                    verdict = await verdicts.get()
                    if not _is_about_lease(verdict):
                        return verdict
                    # verdicts are public, this one may be about somebody else's increment: ask
                    await self._renew()
        except zenoh.ZError as error:
            raise ServiceUnreachableError(f"{self.name} cannot be moved: {error}; connect again") from error
        except TimeoutError:
            raise ServiceUnreachableError(
                f"no verdict on increment {increment.seq} of {self.name} within {VERDICT_DEADLINE_S:g} s; "
                "see `deltaq status` for which service is silent"
            ) from None
        finally:
            del self._awaited[increment.seq]

    async def io(self, outputs: Mapping[str, bool] | None = None) -> IoReply:
        """Set digital outputs by name, and read all outputs and inputs.

        Raises:
            RefusedError: the robot has no such output, or the lease was lost.
            ServiceUnreachableError: no answer in time.
        """
        request = IoRequest(robot=self.name, outputs=dict(outputs or {}), lease=self._token)
        return unpack(IoReply, await self._wire.ask(topics.IO.key(self._cell, robot=self.name), request))

    def take_verdict(self, verdict: Verdict) -> None:
        """A verdict has come; `Cell` calls this."""
        waiting = self._awaited.get(verdict.seq)
        if waiting is not None and verdict.robot == self.name:
            waiting.put_nowait(verdict)

    async def keep_lease(self) -> None:
        """Renew the lease until it is lost; `Cell.lease` runs this beside its block."""
        loop = asyncio.get_running_loop()
        expires_s = loop.time() + self._lease_s
        while self._lost is None:
            await asyncio.sleep(self._lease_s / _RENEWALS_A_LEASE)
            asked_s = loop.time()
            try:
                await self._renew()
                expires_s = asked_s + self._lease_s
            except RefusedError as error:
                self._lost = self._lost or error
            except DeltaqError as error:
                if loop.time() >= expires_s:
                    self._lost = error

    async def release(self) -> None:
        """Give the lease back, if the server can still be told; `Cell.lease` does so on leaving its block."""
        if self._is_released:
            return
        self._is_released = True
        self._lost = RefusedError(ReasonCode.LEASE_NOT_HELD, f"the lease of {self.name} was given back")
        with contextlib.suppress(DeltaqError, zenoh.ZError):
            self._publisher.undeclare()
            await self._ask(LeaseAction.RELEASE)

    async def _renew(self) -> None:
        reply = await self._ask(LeaseAction.RENEW)
        if not reply.granted:
            now = f"{reply.holder} holds it now" if reply.holder else "it has run out"
            self._lost = RefusedError(
                ReasonCode.LEASE_NOT_HELD, f"the lease of {self.name} was lost: {now}", "acquire it again"
            )
            raise self._lost

    async def _ask(self, action: LeaseAction) -> LeaseReply:
        request = LeaseRequest(robot=self.name, action=action, lease=self._token)
        key = topics.LEASE.key(self._cell, robot=self.name)
        return unpack(LeaseReply, await self._wire.ask(key, request))

    def _check_lease(self) -> None:
        if self._lost is not None:
            raise self._lost


def _is_about_lease(verdict: Verdict) -> bool:
    return any(reason.code is ReasonCode.LEASE_NOT_HELD for reason in verdict.reasons)
