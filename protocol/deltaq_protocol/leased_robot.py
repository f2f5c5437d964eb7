"""A robot that this client may move, as long as it holds the lease."""

import asyncio
import contextlib
import itertools
import queue
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Mapping

import zenoh

from deltaq_protocol import topics
from deltaq_protocol.audit import LONGEST_TEXT
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.held_lease import HeldLease
from deltaq_protocol.messages import (
    EarlierIncrement,
    Increment,
    IoReply,
    IoRequest,
    LeaseReply,
    Outcome,
    Phase,
    Reason,
    RobotState,
    RobotSummary,
    Sight,
    ToolRequest,
    Verdict,
    ViewTarget,
)
from deltaq_protocol.proof import Prover
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.stamps import StampStation, stamps_if_asked
from deltaq_protocol.wire import Newest, Wire

# The verdicts on increments that a client sent without waiting, until it reads them.

_MOST = 1024
"""Largest number of sent increments, and of received verdicts, that are kept unread."""


class SentVerdicts:
    """Keeps the newest verdicts on increments that were sent. Each operation is atomic with respect to other threads.

    Attributes:
        queue: the verdicts that were not read yet.
    """

    def __init__(self) -> None:
        self._sent: deque[int] = deque(maxlen=_MOST)
        self.queue: asyncio.Queue[Verdict] = asyncio.Queue(_MOST)

    def expect(self, seq: int) -> None:
        """Note that an increment is about to be sent."""
        self._sent.append(seq)

    def take(self, verdict: Verdict) -> None:
        """Take a verdict, on one of the sent increments or on another."""
        if verdict.seq not in self._sent:
            return
        if self.queue.full():
            with contextlib.suppress(asyncio.QueueEmpty):  # a reader in another thread was quicker
                self.queue.get_nowait()
        self.queue.put_nowait(verdict)

    def read(self) -> list[Verdict]:
        """All unread items."""
        verdicts = []
        with contextlib.suppress(asyncio.QueueEmpty):
            while True:
                verdicts.append(self.queue.get_nowait())
        return verdicts


# How the increments of a leased robot leave this process: each with its proof, and with those that it
# repeats.

REPEATED = 2
"""Earlier increments that each message repeats with a jitter buffer: of links that lose a packet in a hundred,
three in a row are lost once in three hours."""


class IncrementsOut:
    """Sends a robot's increments; any thread may.

    Args:
        wire: to the server.
        cell: name of the cell.
        robot: name of the robot.
        prover: shows that they are the holder's of the lease.
        playout: they wait in the HLI, so each repeats those before it.
    """

    def __init__(self, wire: Wire, cell: str, robot: str, prover: Prover, playout: bool) -> None:
        self._robot = robot
        self._prover = prover
        self._key = topics.INCREMENT.key(cell, robot=robot)
        self._publisher = wire.publisher(topics.INCREMENT, cell, robot)
        self._stamps = stamps_if_asked(f"client-{robot}", [robot])
        self._earlier: deque[EarlierIncrement] = deque(maxlen=REPEATED if playout else 0)

    def state_came(self, cycle: int) -> None:
        """Stamp that the controller has taken the state of a cycle."""
        if self._stamps is not None:
            self._stamps.add(StampStation.STATE_AT_CLIENT, self._robot, cycle)

    def send(
        self, dq: Iterable[float], seq: int, cycle: int, sight: Sight | None, target: ViewTarget | None
    ) -> None:
        """Send the increment `dq` (n,) [rad or m] in answer to the state of a cycle.

        Raises:
            ServiceUnreachableError: the connection was closed.
        """
        # not validated here: only the server decides what is refused
        increment = Increment.model_construct(
            robot=self._robot,
            seq=seq,
            cycle=cycle,
            dq=tuple(float(element) for element in dq),
            sight=sight,
            target=target,
            earlier=tuple(self._earlier),
        )
        self._earlier.append(EarlierIncrement.model_construct(seq=seq, cycle=cycle, dq=increment.dq))
        if self._stamps is not None:
            self._stamps.add(StampStation.INCREMENT_OUT, self._robot, cycle, seq)
        payload = pack(increment)
        try:
            self._publisher.put(payload, attachment=self._prover.prove(self._key, payload))
        except zenoh.ZError as error:
            raise ServiceUnreachableError(
                f"{self._robot} cannot be moved: the connection was closed; connect again"
            ) from error

    def end(self) -> None:
        """Send nothing more.

        Raises:
            ZError: the connection was closed already.
        """
        self._publisher.undeclare()


VERDICT_DEADLINE_S = 0.25
"""Twice as long as an increment may be in flight: a verdict that has not come by then was lost."""
_FIRST_STATE_DEADLINE_S = 0.5
_COUPLING_DEADLINE_S = 10.0
_TRIES, _TRY_PERIOD_S = 10, 0.1
_COUPLING_CYCLES = 10
"""Cycles until a state shows that a change was begun, at least."""


class LeasedRobot:
    """A robot whose lease this client holds; `Cell.lease` returns it and keeps the lease renewed.

    Attributes:
        name: of the robot.
        summary: its joints, units and limits.
        lease: the right to move it.
        sight: how well the controller sees its target, sent with every increment; None: not sent. target: the name
            of that target, sent in the same way.
    """

    def __init__(
        self,
        wire: Wire,
        cell: str,
        name: str,
        summary: RobotSummary,
        granted: LeaseReply,
        newest: Newest[zenoh.Sample, RobotState],
        states: Callable[[], AsyncIterator[RobotState]],
        playout: bool = False,
    ) -> None:
        self.name = name
        self.summary = summary
        self.sight: Sight | None = None
        self.target: ViewTarget | None = None
        self._wire = wire
        self._cell = cell
        self.lease = HeldLease(wire, cell, name, granted)
        self._states = states
        self._newest = newest
        self._out = IncrementsOut(wire, cell, name, self.lease.prover, playout)
        self._seqs = itertools.count(1)
        self._awaited: dict[int, asyncio.Queue[Verdict] | queue.SimpleQueue[Verdict]] = {}
        self._verdicts = SentVerdicts()
        self._releasing: asyncio.Future[None] | None = None

    @property
    def state(self) -> RobotState | None:
        """The newest state; None before the first."""
        return self._newest.value

    async def states(self) -> AsyncIterator[RobotState]:
        """States as they come, the newest only: a slow reader skips states.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
        """
        async for state in self._states():
            self.lease.check()
            self._out.state_came(state.cycle)
            yield state

    async def move(self, dq: Iterable[float]) -> Verdict:
        """Ask for an increment in answer to the newest state, and wait for its verdict.

        Args:
            dq: (n,) increment over one cycle [rad or m].

        Returns:
            The verdict. Its `dq` is what was admitted, which may be less than requested; a request that
            was refused has the outcome `refused`, reasons, and no `dq`. Where no verdict came within
            `VERDICT_DEADLINE_S` the outcome is `unknown`: the increment or its verdict was lost, and the next state
            shows which.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone, or the robot has no state to be answered.
        """
        state = await self._answerable()
        seq = next(self._seqs)
        verdicts: asyncio.Queue[Verdict] = asyncio.Queue()
        self._awaited[seq] = verdicts
        try:
            self._out.send(dq, seq, state.cycle, self.sight, self.target)
            async with asyncio.timeout(VERDICT_DEADLINE_S):
                return await self._own(verdicts)
        except TimeoutError:
            self.lease.check()
            return _no_verdict(self.name, state.cycle, seq)
        finally:
            del self._awaited[seq]

    def move_now(self, dq: Iterable[float], renew: Callable[[], None]) -> Verdict:
        """`move` for a robot whose state has come already; for threads other than the loop's, which wait themselves.

        Args:
            dq: (n,) increment over one cycle [rad or m].
            renew: renews the lease, or raises the error with which it was lost.
        """
        self.lease.check()
        state = self._newest.value
        if state is None:
            raise self._without_state()
        seq = next(self._seqs)
        verdicts: queue.SimpleQueue[Verdict] = queue.SimpleQueue()
        self._awaited[seq] = verdicts
        give_up_s = time.monotonic() + VERDICT_DEADLINE_S
        try:
            self._out.send(dq, seq, state.cycle, self.sight, self.target)
            while True:
                verdict = verdicts.get(timeout=max(0.0, give_up_s - time.monotonic()))
                if not _is_about_lease(verdict):
                    return verdict
                renew()
        except queue.Empty:
            self.lease.check()
            return _no_verdict(self.name, state.cycle, seq)
        finally:
            del self._awaited[seq]

    async def send(self, dq: Iterable[float], cycle: int | None = None) -> int:
        """Ask for an increment and do not wait: its verdict comes with `verdicts` or `new_verdicts`.

        For a controller whose answer or round trip takes longer than a cycle, and for any in a cell with a lookahead.
        `deltaq_protocol.in_flight` adds up the increments that were sent and are not in the setpoint yet.

        Args:
            dq: (n,) increment over one cycle [rad or m].
            cycle: of the state that it answers; None for the newest. With a lookahead the answer to each state has a
                setpoint of its own, so say which it is: a newer one may have come.

        Returns:
            The sequence number, which its verdict carries.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone, or the robot has no state to be answered.
        """
        await self._answerable()
        return self.send_now(dq, cycle)

    def send_now(self, dq: Iterable[float], cycle: int | None = None) -> int:
        """`send` for a robot whose state has come already; any thread may call it."""
        self.lease.check()
        state = self._newest.value
        if state is None:
            raise self._without_state()
        seq = next(self._seqs)
        self._verdicts.expect(seq)
        answers = state.cycle if cycle is None else cycle
        self._out.send(dq, seq, answers, self.sight, self.target)
        return seq

    async def verdicts(self) -> AsyncIterator[Verdict]:
        """Stream of the verdicts on increments sent with `send`; a slow reader loses the oldest.

        Of two verdicts on one sequence number the last counts: the admission of the first came too late.
        A verdict that was lost in transit does not come: its sequence number is missing. One reader at a time.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
        """
        while True:
            self.lease.check()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(VERDICT_DEADLINE_S):
                    verdict = await self._own(self._verdicts.queue)
                yield verdict

    async def new_verdicts(self) -> list[Verdict]:
        """The verdicts on increments sent with `send` since the last call; does not wait.

        As with `verdicts`, of two verdicts on one sequence number the last counts, and a lost verdict is missing.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
        """
        self.lease.check()
        come = self._verdicts.read()
        if any(map(_is_about_lease, come)):
            await self.lease.renew()
        return [verdict for verdict in come if not _is_about_lease(verdict)]

    def new_verdicts_now(self, renew: Callable[[], None]) -> list[Verdict]:
        """`new_verdicts` for threads other than the loop's; `renew` as in `move_now`."""
        self.lease.check()
        come = self._verdicts.read()
        if any(map(_is_about_lease, come)):
            renew()
        return [verdict for verdict in come if not _is_about_lease(verdict)]

    async def io(self, outputs: Mapping[str, bool] | None = None, note: str = "") -> IoReply:
        """Set digital outputs by name, and read all outputs and inputs; `note` is for the audit log and recordings.

        Raises:
            RefusedError: the robot has no such output, or the lease was lost.
            ServiceUnreachableError: no answer in time.
        """
        request = IoRequest(robot=self.name, outputs=dict(outputs or {}), note=note[:LONGEST_TEXT])
        prove = self.lease.prover.prove_next
        return unpack(IoReply, await self._wire.ask(topics.IO, self._cell, request, self.name, prove=prove))

    async def couple(self, tool: str | None) -> RobotState:
        """Couple the tool in front of the tool changer, or release the present one; returns when its input confirms it.

        Args:
            tool: one of the robot's `tools`; None: open the changer.

        Raises:
            RefusedError: there is no such tool, the robot moves, the tool would be too near to a body, another one is
                coupled, the changer is closed or did not confirm in time, or the lease was lost.
            ServiceUnreachableError: no answer in time.
        """
        wanted, before = tool or "", await self._answerable()
        request, prove = ToolRequest(robot=self.name, tool=wanted), self.lease.prover.prove_next
        for tries_left in range(_TRIES, 0, -1):
            try:
                await self._wire.ask(topics.TOOL, self._cell, request, self.name, prove=prove)
                break
            except RefusedError as error:
                if error.code != ReasonCode.NOT_AT_REST or tries_left == 1:
                    raise
            await asyncio.sleep(_TRY_PERIOD_S)  # its drives are still catching up
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_COUPLING_DEADLINE_S):
                async for state in self.states():
                    if state.cycle > before.cycle + _COUPLING_CYCLES and state.coupled == wanted:
                        return state
                    if state.phase is Phase.HELD and before.phase is not Phase.HELD:
                        break
        what = f"that {wanted} is locked" if wanted else "that it is open"
        text = f"the tool changer of {self.name} did not confirm {what}"
        raise RefusedError(ReasonCode.TOOL_MISMATCH, text, "see to the changer, then couple or release again")

    def take_verdict(self, verdict: Verdict) -> None:
        """Take a verdict on this robot; called by `Cell`."""
        if (waiting := self._awaited.get(verdict.seq)) is not None:
            waiting.put_nowait(verdict)
        else:
            self._verdicts.take(verdict)

    async def release(self) -> None:
        """Release the lease, if the server can still be reached; `Cell.lease` does so when its block is left."""
        if self._releasing is None:
            self._releasing = asyncio.ensure_future(self._release())
        await asyncio.shield(self._releasing)

    def release_now(self) -> None:
        """`release` without a loop: the loop ended before its controller did."""
        if self._releasing is None:
            self.lease.release_now()

    async def _release(self) -> None:
        self.lease.end()
        with contextlib.suppress(DeltaqError, zenoh.ZError):
            self._out.end()
            await self.lease.release()

    async def _answerable(self) -> RobotState:
        """The newest state, or the first."""
        self.lease.check()
        try:
            state, _ = await self._newest.after(0, _FIRST_STATE_DEADLINE_S)
        except TimeoutError:
            raise self._without_state() from None
        return state

    def _without_state(self) -> ServiceUnreachableError:
        return ServiceUnreachableError(
            f"no state of {self.name} within {_FIRST_STATE_DEADLINE_S:g} s; "
            "is its Robot Server up (`deltaq status`)?"
        )

    async def _own(self, verdicts: asyncio.Queue[Verdict]) -> Verdict:
        """The next verdict on an increment of this client."""
        while True:
            verdict = await verdicts.get()
            if not _is_about_lease(verdict):
                return verdict
            # verdicts are public, and this one may concern another client's increment: ask
            await self.lease.renew()


def _no_verdict(robot: str, cycle: int, seq: int) -> Verdict:
    silence = Reason(code=ReasonCode.UNREACHABLE, what="no verdict for [s]", bound=VERDICT_DEADLINE_S)
    return Verdict(robot=robot, cycle=cycle, seq=seq, outcome=Outcome.UNKNOWN, reasons=(silence,))


def _is_about_lease(verdict: Verdict) -> bool:
    return any(reason.code is ReasonCode.LEASE_NOT_HELD for reason in verdict.reasons)
