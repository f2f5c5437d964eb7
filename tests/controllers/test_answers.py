"""`drive` in a cell with a lookahead: against a real HLI over zenoh, whose guarded realm is played by a peer."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest
from guarded_peer import GuardedPeer, guarded_peer
from small_cell import small_cell, told, tool_pose

from deltaq_controllers.interface import View
from deltaq_controllers.live import drive
from deltaq_controllers.statistics import ControlStatistics
from deltaq_protocol import connect
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_services.hli.shell import Hli

STEP = 1e-4


@dataclass
class Running:
    """A running HLI, its peer and a client; `drive` moves the first joint of `fr`."""

    hli: Hli
    peer: GuardedPeer
    cell: Cell
    statistics: ControlStatistics = field(default_factory=ControlStatistics)
    seen: list[float] = field(default_factory=list)
    wanted: Callable[[], bool] = lambda: False
    reached: asyncio.Event = field(default_factory=asyncio.Event)

    def increment(self, view: View) -> Array:
        self.seen.append(float(view.own.q_cmd[0]))
        if self.wanted():
            self.reached.set()
        return np.array([STEP, *np.zeros(5)])

    @asynccontextmanager
    async def driving(self) -> AsyncIterator[asyncio.Task[None]]:
        task = asyncio.create_task(drive(self.cell, "fr", self, self.statistics))
        try:
            yield task
        finally:
            task.cancel()
            await asyncio.wait([task])

    async def until(self, wanted: Callable[[], bool]) -> None:
        """Go on until an increment is asked for while it is so."""
        self.wanted = wanted
        self.reached.clear()
        async with asyncio.timeout(300):
            await self.reached.wait()


@pytest.fixture
async def running() -> AsyncIterator[Running]:
    # who is slow here is the machine, and not the holder of a lease
    description = small_cell(gate={"lookahead_cycles": 3}, lease_s=20.0)
    async with (
        guarded_peer(description) as peer,
        Hli(description, told(description), tool_pose) as hli,
        connect(description.hli, client="tester") as cell,
    ):
        await peer.turn()
        cycles = asyncio.create_task(peer.run())
        yield Running(hli, peer, cell)
        cycles.cancel()


@pytest.mark.long
async def test_where_no_verdict_comes_every_state_is_answered_and_they_are_counted(running: Running) -> None:
    running.peer.judges = False
    async with running.driving():
        await running.until(lambda: running.statistics.unanswered >= 10)
    # those that are given up are not reckoned with: it never moved
    assert max(running.seen) <= running.seen[0] + 3 * STEP + 1e-12
    assert running.statistics.cycles == running.statistics.unanswered


async def test_after_verdicts_that_were_lost_it_goes_on_from_where_the_robot_is(running: Running) -> None:
    async with running.driving():
        await running.until(lambda: len(running.seen) > 10)
        running.peer.judges = False
        await running.until(lambda: running.statistics.unanswered > 3)
        running.peer.judges = True
        begun = len(running.seen)
        await running.until(lambda: len(running.seen) > begun + 20)
    assert running.statistics.summary()["gate"]["admitted"] > 10
    assert running.seen[-1] == pytest.approx(running.peer.q_cmd["fr"][0], abs=5 * STEP)


async def test_a_lost_lease_ends_it(running: Running) -> None:
    async with running.driving() as task:
        await running.until(lambda: len(running.seen) > 5)
        async with running.cell.lease("fr", client="second", take=True):
            async with asyncio.timeout(300):
                with pytest.raises(RefusedError, match="second holds it now"):
                    await task


async def test_an_hli_that_is_gone_ends_it() -> None:
    # who is slow here is the machine, and not the holder of a lease
    description = small_cell(gate={"lookahead_cycles": 3}, lease_s=20.0)
    async with guarded_peer(description) as peer:
        hli = Hli(description, told(description), tool_pose)
        await hli.__aenter__()
        async with connect(description.hli, client="tester") as cell:
            await peer.turn()
            cycles = asyncio.create_task(peer.run())
            running = Running(hli, peer, cell)
            async with running.driving() as task:
                await running.until(lambda: len(running.seen) > 5)
                await hli.__aexit__()
                async with asyncio.timeout(300):
                    with pytest.raises((RefusedError, ServiceUnreachableError)):
                        await task
            cycles.cancel()


@pytest.mark.long
async def test_while_verdicts_come_each_increment_is_added_to_the_one_before(running: Running) -> None:
    async with running.driving():
        await running.until(lambda: len(running.seen) > 60)
    moved = np.diff(running.seen[5:])
    # on a busy machine a state may be missed, and what that cost is known only later
    assert np.median(moved) == pytest.approx(STEP)
