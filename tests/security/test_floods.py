"""Those who flood, and those who do not read: what others get meanwhile, in counts and in order, over real sockets."""

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
import zenoh
from guarded_peer import guarded_peer
from json_client import json_client
from small_cell import small_cell, told, tool_pose

from deltaq_protocol import connect, topics
from deltaq_protocol.codec import pack
from deltaq_protocol.messages import (
    DescribeRequest,
    Increment,
    IoRequest,
    LeaseAction,
    LeaseRequest,
    Outcome,
    ResetRequest,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.session import open_session
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.places import MAX_CONNECTIONS, MAX_STOP_PLACES
from deltaq_services.hli.shell import Hli

DQ = (0.001,) * 6
CYCLES = 40


@asynccontextmanager
async def serving() -> AsyncIterator[tuple[Hli, Any]]:
    cell = small_cell(lease_s=60.0)  # no lease ends because a busy machine keeps its holder waiting
    async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose, ClientRoles("operator")) as hli:
        await peer.turn()
        yield hli, peer


def assert_judged(verdict: Verdict, seq: int) -> None:
    """An increment has its verdict: the gate's, or that its state was too old, for no machine is kept from pausing."""
    assert verdict.seq == seq
    assert verdict.outcome is Outcome.ADMITTED or {reason.code for reason in verdict.reasons} == {
        ReasonCode.NOT_READY
    }


class Flood:
    """A zenoh session that says the same without end, in a thread of its own."""

    def __init__(self, where: str, say: Callable[[Any], None]) -> None:
        self._session = open_session(connect=[where], must_connect=True)
        self._ends = threading.Event()
        self.said = 0
        self._say = say
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ends.is_set():
            self._say(self._session)
            self.said += 1

    def end(self) -> None:
        self._ends.set()
        self._thread.join()
        self._session.close()


def increments(size: int) -> Callable[[Any], None]:
    forged = Increment(robot="fr", seq=1, cycle=100, dq=DQ, lease="x" * size)
    key = topics.INCREMENT.key("small", robot="fr")

    def say(session: Any) -> None:
        block = zenoh.CongestionControl.BLOCK
        session.put(key, pack(forged), attachment=bytes(40), congestion_control=block)

    return say


def queries(topic: topics.Topic, message: Any, robot: str = "") -> Callable[[Any], None]:
    def say(session: Any) -> None:
        key = topic.key("small", robot=robot)
        for _ in session.get(key, payload=pack(message), attachment=bytes(80), timeout=0.5):
            pass

    return say


FLOODS = {
    "increments": increments(16),
    "oversized increments": increments(200_000),
    "leases": queries(topics.LEASE, LeaseRequest(robot="fr", action=LeaseAction.RENEW), "fr"),
    "challenges": queries(topics.CHALLENGE, DescribeRequest()),
    "descriptions": queries(topics.DESCRIPTION, DescribeRequest()),
    "statuses": queries(topics.STATUS, DescribeRequest()),
    "resets": queries(topics.RESET, ResetRequest(robot="fr")),
    "outputs": queries(topics.IO, IoRequest(robot="gr", outputs={"gripper": True}), "gr"),
}


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize("name", FLOODS)
async def test_during_a_zenoh_flood_every_increment_is_judged_and_every_state_published(name: str) -> None:
    """In lockstep: the next state comes when the increment before it has its verdict, so no clock decides."""
    async with serving() as (hli, peer):
        where = peer.cell.hli
        async with connect(where, client="holder", token="operator") as cell, cell.lease("fr") as robot:
            observed: list[int] = []
            verdicts = aiter(robot.verdicts())
            floods = [await asyncio.to_thread(Flood, where, FLOODS[name]) for _ in range(2)]
            try:
                while min(flood.said for flood in floods) < 20:
                    await asyncio.sleep(0)
                for _ in range(CYCLES):
                    cycle = await peer.turn()
                    async for state in cell.states("fr"):
                        if state.cycle >= cycle:
                            observed.append(state.cycle)
                            break
                    seq = await robot.send(DQ)
                    async with asyncio.timeout(300):
                        verdict = await anext(verdicts)
                    assert verdict.cycle == cycle
                    assert_judged(verdict, seq)
                await cell.stop()
                await robot.lease.renew()
            finally:
                for flood in floods:
                    await asyncio.to_thread(flood.end)
            assert len(set(observed)) == CYCLES
            counters = hli.status().hli
            assert counters.get("increment_dropped", 0) == 0
            assert counters["increments"] == CYCLES
            assert counters["verdicts_admitted"] > 0
            if "increments" in name:
                assert counters["increments_unproven"] >= 40


@pytest.mark.long
async def test_subscribers_that_never_read_do_not_affect_others() -> None:
    async with serving() as (_, peer):
        where = peer.cell.hli
        stuck = [await asyncio.to_thread(open_session, connect=[where], must_connect=True) for _ in range(3)]
        for session in stuck:
            session.declare_subscriber("deltaq/**", zenoh.handlers.FifoChannel(1))
        async with connect(where) as cell, cell.lease("fr") as robot:
            verdicts = aiter(robot.verdicts())
            for _ in range(10 * CYCLES):
                await peer.turn()
                seq = await robot.send(DQ)
                async with asyncio.timeout(300):
                    assert_judged(await anext(verdicts), seq)
        for session in stuck:
            await asyncio.to_thread(session.close)


@pytest.mark.long
async def test_a_flood_of_lines_does_not_delay_the_lease_holder() -> None:
    async with serving() as (hli, peer), json_client(peer.cell.tcp_port) as holder:
        port = peer.cell.tcp_port
        await holder.ask("lease", type="lease", robot="fr", action="acquire")
        async with contextlib.AsyncExitStack() as stack:
            floods = [await stack.enter_async_context(json_client(port)) for _ in range(20)]
            readers = [asyncio.create_task(flood.reader.read()) for flood in floods]
            line = b'{"type":"increment","robot":"fr","seq":1,"cycle":100,"dq":[0,0,0,0,0,0]}\n'
            for flood in floods:
                flood.send_bytes(line * 5000)
            async with asyncio.timeout(300):
                while not hli.status().hli.get("tcp_lines_slowed"):
                    await asyncio.sleep(0.001)
            for seq in range(CYCLES):
                cycle = await peer.turn()
                holder.send(type="increment", robot="fr", seq=seq, cycle=cycle, dq=list(DQ))
                assert_judged(Verdict.model_validate(await holder.receive("verdict")), seq)
            assert hli.status().hli["refused"] < 20 * 5000  # it was served among them, not after them
            for reader in readers:
                reader.cancel()


async def test_a_refusal_goes_to_its_sender_alone() -> None:
    async with (
        serving() as (_, peer),
        json_client(peer.cell.tcp_port) as rude,
        connect(peer.cell.hli) as cell,
        cell.lease("fr") as robot,
    ):
        heard = aiter(cell.verdicts("fr"))
        first = asyncio.create_task(anext(heard))
        await asyncio.sleep(0)  # it listens from here on
        cycle = await peer.turn()
        for seq in range(50):
            rude.send(type="increment", robot="fr", seq=seq, cycle=cycle, dq=[0.0] * 6)
        for _ in range(50):
            assert (await rude.receive("verdict"))["reasons"][0]["code"] == "lease_not_held"
        await peer.turn()  # a state of now, however long the above took
        moved = await robot.move(DQ)
        assert_judged(moved, moved.seq)
        # what was told to all comes in order: any of the fifty would have come before
        async with asyncio.timeout(300):
            assert await first == moved


async def test_a_stop_is_obeyed_although_idle_connections_fill_every_place() -> None:
    async with serving() as (_, peer), contextlib.AsyncExitStack() as stack:
        port = peer.cell.tcp_port
        for _ in range(MAX_CONNECTIONS + MAX_STOP_PLACES + 40):
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            stack.callback(writer.close)
        async with json_client(port, name=None) as late:
            late.send_bytes(b'{"type":"hello","protocol":1,"client":"x"}\n{"type":"stop"}\n')
            assert (await late.receive("done"))["what"] == "stop"
        assert (await peer.commands.get()).kind == "stop"


async def test_a_stop_overtakes_earlier_lines() -> None:
    async with serving() as (hli, peer), json_client(peer.cell.tcp_port) as client:
        client.send_bytes(b'{"type":"describe"}\n' * 2000 + b'{"type":"stop"}\n{"type":"describe"}\n')
        answers = [(await client.receive("description", "done"))["type"] for _ in range(600)]
        assert "done" in answers
        assert (await peer.commands.get()).kind == "stop"
        assert hli.status().hli["stops"] == 1


@pytest.mark.parametrize(
    "line", [b'{"type":"io","robot":"stop"}\n', b'"stop"\n', b'{"stop":"stop"\n', b'{"type":"stop"}']
)
async def test_a_lookalike_of_a_stop_is_no_stop(line: bytes) -> None:
    async with serving() as (hli, peer), json_client(peer.cell.tcp_port) as client:
        client.send_bytes(line * 3 if line.endswith(b"\n") else line)
        if line.endswith(b"\n"):
            assert (await client.receive("error"))["type"] == "error"
        else:
            await asyncio.sleep(0)
        assert "stops" not in hli.status().hli
        assert peer.commands.empty()
