"""The blocking client for scripts and notebooks: the methods of the asyncio client without `async`.

    with connect("tcp/127.0.0.1:7447") as cell:
        with cell.lease("fr") as robot:
            for state in robot.states():
                verdict = robot.move(dq)  # (n,) [rad or m] for one cycle; what was admitted comes back

The event loop runs in a separate thread, so the lease is renewed while the script computes. If the controller or its
round trip takes longer than a cycle, or the cell has a lookahead, do not wait for verdicts: call `robot.send(dq)`
and read `robot.new_verdicts()`; `deltaq_protocol.in_flight` keeps account of increments in flight.

In a notebook, `cell = connect().open()` and `robot = cell.lease("fr").open()` last until `robot.close()` and
`cell.close()`, or until the interpreter ends.
"""

import asyncio
import atexit
import os
import sys
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, contextmanager
from types import TracebackType
from typing import Any, TypeVar

from numpy.typing import ArrayLike

from deltaq_protocol import client as asynchronous
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import (
    Description,
    Done,
    IoReply,
    RobotState,
    RobotSummary,
    Status,
    Verdict,
    ViewReply,
    ViewTarget,
)
from deltaq_protocol.opening import Opening
from deltaq_protocol.subscriptions import SILENCE_S

# An event loop in a separate thread, for callers that have none.

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

THREAD_NAME = "deltaq client"


class Background:
    """An event loop in a separate thread."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=THREAD_NAME, daemon=True)
        self._thread.start()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine and return its result; an interrupt cancels it.

        Raises:
            ServiceUnreachableError: the loop has ended.
        """
        if self._loop.is_closed():
            coroutine.close()
            raise ServiceUnreachableError("the connection was closed; connect again")
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def iterate(self, items: AsyncIterator[T]) -> Iterator[T]:
        """The items of an async iterator."""

        async def following() -> T:
            return await anext(items)

        while True:
            yield self.run(following())

    @contextmanager
    def entered(self, manager: AbstractAsyncContextManager[T]) -> Iterator[T]:
        """An async context manager as a plain one."""

        async def enter() -> T:
            return await manager.__aenter__()

        async def leave() -> None:
            # the error of the block stays in the caller's thread: an interrupt thrown into a task would end
            # the loop, and the lease could not be given back
            await manager.__aexit__(None, None, None)

        value = self.run(enter())
        try:
            yield value
        finally:
            if not self._loop.is_closed():
                self.run(leave())

    def close(self) -> None:
        """End the loop and its thread."""

        async def finish() -> None:
            rest = asyncio.all_tasks() - {asyncio.current_task()}
            for task in rest:
                task.cancel()
            await asyncio.gather(*rest, return_exceptions=True)
            await self._loop.shutdown_asyncgens()
            await self._loop.shutdown_default_executor()

        self.run(finish())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class BlockingOpening(AbstractContextManager[T_co]):
    """A context manager with `open` and `close` as well, for notebooks; it opens once.

    If it is not closed, it closes when the interpreter ends.

    Args:
        manager: opens and closes.
    """

    def __init__(self, manager: AbstractContextManager[T_co]) -> None:
        self._manager = manager
        self._is_open = False

    def open(self) -> T_co:
        """Open, as entering the block does."""
        value = self._manager.__enter__()
        self._is_open = True
        atexit.register(self.close)
        return value

    def close(self) -> None:
        """Close, as leaving the block does; nothing happens if it is not open."""
        self.__exit__(None, None, None)

    def __enter__(self) -> T_co:
        return self.open()

    def __exit__(self, *error: Any) -> bool | None:
        if not self._is_open:
            return None
        self._is_open = False
        atexit.unregister(self.close)
        return self._manager.__exit__(*error)


class BlockingRobot:
    """A robot whose lease this client holds; see `deltaq_protocol.leased_robot.LeasedRobot`.

    The operations of every cycle run in the caller's thread: a detour through the loop's thread would cost cycles.
    """

    def __init__(
        self,
        robot: LeasedRobot,
        background: Background,
        states: Callable[[], Iterator[RobotState]],
        close: Callable[[], None],
    ) -> None:
        self._robot = robot
        self._background = background
        self._states = states
        self._close = close
        self.name: str = robot.name
        self.summary: RobotSummary = robot.summary

    @property
    def state(self) -> RobotState | None:
        """The newest state; None before the first."""
        return self._robot.state

    def states(self) -> Iterator[RobotState]:
        """States as they come, the newest only; see `LeasedRobot.states`."""
        for state in self._states():
            self._robot.lease.check()
            yield state

    def move(self, dq: Iterable[float]) -> Verdict:
        """Ask for an increment `dq` (n,) [rad or m] and wait for its verdict; see `LeasedRobot.move`."""
        if self._robot.state is None:
            return self._background.run(self._robot.move(dq))
        return self._robot.move_now(dq, self._renew)

    def send(self, dq: Iterable[float], cycle: int | None = None) -> int:
        """Ask for an increment `dq` (n,) [rad or m] and do not wait for its verdict; see `LeasedRobot.send`."""
        if self._robot.state is None:
            return self._background.run(self._robot.send(dq, cycle))
        return self._robot.send_now(dq, cycle)

    def new_verdicts(self) -> list[Verdict]:
        """The verdicts on increments sent with `send` since the last call; see `LeasedRobot.new_verdicts`."""
        return self._robot.new_verdicts_now(self._renew)

    def verdicts(self) -> Iterator[Verdict]:
        """A stream of verdicts on increments sent with `send`; see `LeasedRobot.verdicts`."""
        return self._background.iterate(self._robot.verdicts())

    def _renew(self) -> None:
        self._background.run(self._robot.lease.renew())

    def close(self) -> None:
        """Give the lease back, as leaving the block does; `with` is the safer way."""
        self._close()

    def io(self, outputs: Mapping[str, bool] | None = None) -> IoReply:
        """Set digital outputs, and read all outputs and inputs; see `LeasedRobot.io`."""
        return self._background.run(self._robot.io(outputs))

    def couple(self, tool: str | None) -> RobotState:
        """Couple a tool, or release the present one with None; see `LeasedRobot.couple`."""
        return self._background.run(self._robot.couple(tool))


class BlockingCell:
    """A connection to a running cell; see `deltaq_protocol.client.Cell`."""

    def __init__(self, cell: asynchronous.Cell, background: Background, close: Callable[[], None]) -> None:
        self._cell = cell
        self._background = background
        self._close = close
        self.robots: dict[str, RobotSummary] = cell.robots

    @property
    def description(self) -> Description:
        """Everything needed to model the cell; see `Cell.description`."""
        return self._cell.description

    def state(self, robot: str) -> RobotState | None:
        """The newest state of a robot; None before the first."""
        return self._cell.state(robot)

    def states(self, robot: str) -> Iterator[RobotState]:
        """States of a robot as they come, the newest only; see `Cell.states`."""
        newest, seen = self._cell.newest(robot), 0
        while True:
            try:
                state, seen = newest.wait_after(seen, SILENCE_S)
            except TimeoutError:
                self._background.run(self._cell.ask_whether_there())  # a robot that is offline is waited for
                continue
            yield state

    def verdicts(self, robot: str) -> Iterator[Verdict]:
        """Every verdict on a robot's increments; see `Cell.verdicts`."""
        return self._background.iterate(self._cell.verdicts(robot))

    def stop(self) -> Done:
        """Bring every robot of the cell to rest; see `Cell.stop`."""
        return self._background.run(self._cell.stop())

    def dry_run(self, robot: str, dq: ArrayLike) -> Verdict:
        """The gate's verdict on an increment (n,) [rad or m] if it came now; see `Cell.dry_run`."""
        return self._background.run(self._cell.dry_run(robot, dq))

    def io(self, robot: str) -> IoReply:
        """Digital outputs and inputs of a robot; see `Cell.io`."""
        return self._background.run(self._cell.io(robot))

    def view(
        self,
        robot: str,
        distance_m: float | None = None,
        leader: str | None = None,
        aim_offset_m: ArrayLike | None = None,
        focus_m: ArrayLike | None = None,
        targets: Sequence[ViewTarget] | None = None,
    ) -> ViewReply:
        """Ask the controller that follows with a robot's camera for another view; see `Cell.view`."""
        asked = self._cell.view(robot, distance_m, leader, aim_offset_m, focus_m, targets)
        return self._background.run(asked)

    def allow_contact(self, contact: str, allowed: bool = True) -> Done:
        """Let bodies touch, or forbid it again; see `Cell.allow_contact`."""
        return self._background.run(self._cell.allow_contact(contact, allowed))

    def reset(self, robot: str) -> Done:
        """Leave `held`; see `Cell.reset`."""
        return self._background.run(self._cell.reset(robot))

    def status(self) -> Status:
        """The running cell: phases, leases, ages, counters; see `Cell.status`."""
        return self._background.run(self._cell.status())

    def round_trip_s(self) -> float:
        """The shortest of five ways to the server and back [s]; see `Cell.round_trip_s`."""
        return self._background.run(self._cell.round_trip_s())

    def lease(
        self, robot: str, client: str | None = None, take: bool = False, playout: bool = False
    ) -> BlockingOpening[BlockingRobot]:
        """Hold the lease of a robot for the length of a block, or from `open` to `close`; see `Cell.lease`."""
        opening: BlockingOpening[BlockingRobot] = BlockingOpening(
            self._leased(self._cell.lease(robot, client, take, playout), close=lambda: opening.close())
        )
        return opening

    @contextmanager
    def _leased(self, lease: Opening[LeasedRobot], close: Callable[[], None]) -> Iterator[BlockingRobot]:
        with self._background.entered(lease) as leased:
            yield BlockingRobot(leased, self._background, lambda: self.states(leased.name), close)

    def close(self) -> None:
        """Give back every lease and end the connection, as leaving the block does; `with` is the safer way."""
        self._close()


def connect(
    address: str = asynchronous.DEFAULT_ADDRESS,
    client: str = "python",
    token: str | None = None,
    identity: str | os.PathLike[str] | None = None,
) -> BlockingOpening[BlockingCell]:
    """Connect to a running cell for the length of a block, or from `open` to `close`.

    See `deltaq_protocol.client.connect`. A script that lets the error of a cell that does not answer pass ends with
    that error in one line, unless it has an exception hook of its own.
    """
    return connected(asynchronous.connect(address, client, token, identity), BlockingCell)


C = TypeVar("C", bound=BlockingCell)


def connected(
    connection: AbstractAsyncContextManager[asynchronous.Cell],
    cell_class: Callable[[asynchronous.Cell, Background, Callable[[], None]], C],
) -> BlockingOpening[C]:
    """Wrap an asyncio connection for scripts; `cell_class` makes the cell."""
    if sys.excepthook is sys.__excepthook__:
        sys.excepthook = _in_one_line
    opening: BlockingOpening[C] = BlockingOpening(
        _connected(connection, cell_class, close=lambda: opening.close())
    )
    return opening


def _in_one_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if issubclass(kind, ServiceUnreachableError):
        print(f"error: {error}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


@contextmanager
def _connected(
    connection: AbstractAsyncContextManager[asynchronous.Cell],
    cell_class: Callable[[asynchronous.Cell, Background, Callable[[], None]], C],
    close: Callable[[], None],
) -> Iterator[C]:
    background = Background()
    try:
        with background.entered(connection) as cell:
            yield cell_class(cell, background, close)
    finally:
        background.close()
