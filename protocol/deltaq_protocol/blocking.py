"""The client for scripts and notebooks: the same verbs without `async`.

    with connect("tcp/127.0.0.1:7447") as cell:
        with cell.lease("fr") as robot:
            for state in robot.states():
                verdict = robot.move(dq)  # (n,) [rad or m] for one cycle; what was admitted comes back

The event loop runs in a thread of its own, so the lease is renewed while the script computes.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Coroutine, Iterable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, contextmanager
from typing import Any, TypeVar

from numpy.typing import ArrayLike

from deltaq_protocol import client as asynchronous
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import (
    Description,
    Done,
    IoReply,
    RobotState,
    RobotSummary,
    Status,
    Verdict,
)

T = TypeVar("T")


class _Background:
    """An event loop in a thread of its own."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="deltaq client", daemon=True)
        self._thread.start()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine and return its result; an interrupt cancels it."""
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
            self.run(leave())

    def close(self) -> None:
        """End the loop and its thread."""

        async def finish() -> None:
            rest = asyncio.all_tasks() - {asyncio.current_task()}
            for task in rest:
                task.cancel()
            await asyncio.gather(*rest, return_exceptions=True)
            await self._loop.shutdown_asyncgens()

        self.run(finish())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class BlockingRobot:
    """A robot whose lease this client holds; see `deltaq_protocol.leased_robot.LeasedRobot`."""

    def __init__(self, robot: LeasedRobot, background: _Background) -> None:
        self._robot = robot
        self._background = background
        self.name: str = robot.name
        self.summary: RobotSummary = robot.summary

    @property
    def state(self) -> RobotState | None:
        """The newest state; None before the first."""
        return self._robot.state

    def states(self) -> Iterator[RobotState]:
        """States as they come, the newest only; see `LeasedRobot.states`."""
        return self._background.iterate(self._robot.states())

    def move(self, dq: Iterable[float]) -> Verdict:
        """Ask for an increment `dq` (n,) [rad or m] and wait for its verdict; see `LeasedRobot.move`."""
        return self._background.run(self._robot.move(dq))

    def io(self, outputs: Mapping[str, bool] | None = None) -> IoReply:
        """Set digital outputs, and read all outputs and inputs; see `LeasedRobot.io`."""
        return self._background.run(self._robot.io(outputs))


class BlockingCell:
    """A connection to a running cell; see `deltaq_protocol.client.Cell`."""

    def __init__(self, cell: asynchronous.Cell, background: _Background) -> None:
        self._cell = cell
        self._background = background
        self.description: Description = cell.description
        self.robots: dict[str, RobotSummary] = cell.robots

    def state(self, robot: str) -> RobotState | None:
        """The newest state of a robot; None before the first."""
        return self._cell.state(robot)

    def states(self, robot: str) -> Iterator[RobotState]:
        """States of a robot as they come, the newest only; see `Cell.states`."""
        return self._background.iterate(self._cell.states(robot))

    def verdicts(self, robot: str) -> Iterator[Verdict]:
        """Every verdict on a robot's increments; see `Cell.verdicts`."""
        return self._background.iterate(self._cell.verdicts(robot))

    def stop(self) -> Done:
        """Bring every robot of the cell to rest; see `Cell.stop`."""
        return self._background.run(self._cell.stop())

    def dry_run(self, robot: str, dq: ArrayLike) -> Verdict:
        """What the gate would say to an increment (n,) [rad or m] now; see `Cell.dry_run`."""
        return self._background.run(self._cell.dry_run(robot, dq))

    def allow_contact(self, contact: str, allowed: bool = True) -> Done:
        """Let bodies touch, or forbid it again; see `Cell.allow_contact`."""
        return self._background.run(self._cell.allow_contact(contact, allowed))

    def reset(self, robot: str) -> Done:
        """Leave `held`; see `Cell.reset`."""
        return self._background.run(self._cell.reset(robot))

    def status(self) -> Status:
        """The running cell: phases, leases, ages, counters; see `Cell.status`."""
        return self._background.run(self._cell.status())

    @contextmanager
    def lease(self, robot: str, client: str | None = None, take: bool = False) -> Iterator[BlockingRobot]:
        """Hold the lease of a robot for the length of the block; see `Cell.lease`."""
        with self._background.entered(self._cell.lease(robot, client, take)) as leased:
            yield BlockingRobot(leased, self._background)


@contextmanager
def connect(
    address: str = asynchronous.DEFAULT_ADDRESS, client: str = "python", token: str | None = None
) -> Iterator[BlockingCell]:
    """Connect to a running cell for the length of the block; see `deltaq_protocol.client.connect`."""
    background = _Background()
    try:
        with background.entered(asynchronous.connect(address, client, token)) as cell:
            yield BlockingCell(cell, background)
    finally:
        background.close()
