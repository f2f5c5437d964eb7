"""JSON lines over real TCP, the guarded realm over real zenoh: bad clients first."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from typing import Any

import pytest
from guarded_peer import GuardedPeer, guarded_peer
from json_client import JsonClient, json_client
from small_cell import small_cell, told, tool_pose

from deltaq_protocol import topics
from deltaq_protocol.messages import PROTOCOL_VERSION
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli import tcp_connection
from deltaq_services.hli.line_requests import MAX_LINE_BYTES
from deltaq_services.hli.places import MAX_WAITING
from deltaq_services.hli.shell import Hli
from deltaq_services.hli.tcp_connection import MAX_UNREAD_BYTES
from deltaq_services.hli.tcp_front import MAX_CONNECTIONS

ZEROS = [0.0] * 6


class Running:
    """An HLI and the peer that plays its guarded realm."""

    def __init__(self, hli: Hli, peer: GuardedPeer) -> None:
        self.hli = hli
        self.peer = peer
        self.port = peer.cell.tcp_port

    async def counted(self, name: str, at_least: int = 1) -> None:
        """Wait until something has been counted."""
        async with asyncio.timeout(300):
            while self.hli.status().hli.get(name, 0) < at_least:
                await asyncio.sleep(0.005)

    async def commanded(self) -> Any:
        """The next command that the gate got."""
        async with asyncio.timeout(300):
            return await self.peer.commands.get()


@pytest.fixture
async def running() -> AsyncIterator[Running]:
    cell = small_cell()
    async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose) as hli:
        yield Running(hli, peer)


async def leased(client: JsonClient, robot: str = "fr") -> dict[str, Any]:
    reply = await client.ask("lease", type="lease", robot=robot, action="acquire")
    assert reply.get("granted"), reply
    return reply


def increment(seq: int, cycle: int, dq: Any = None, robot: str = "fr") -> dict[str, Any]:
    return {"type": "increment", "robot": robot, "seq": seq, "cycle": cycle, "dq": dq or ZEROS}


# --- refused, and the connection lives ---------------------------------------------------------------


async def test_bad_increments_are_refused_with_their_reasons_and_the_next_good_one_admitted(
    running: Running,
) -> None:
    async with json_client(running.port) as client:
        cycle = await running.peer.turn()
        await leased(client)
        nan = json.dumps(increment(1, cycle, [float("nan")] * 6)).encode() + b"\n"
        assert b"NaN" in nan
        client.send_bytes(nan)
        client.send(**increment(2, cycle, [None] * 6))
        client.send(**increment(3, cycle, [0.0] * 7))
        client.send(**increment(4, cycle - 50))
        client.send(**increment(5, cycle + 1))
        client.send(**increment(5, cycle))
        client.send(**increment(6, cycle, robot="gr", dq=[0.0] * 9))
        client.send(**increment(7, cycle, robot="ghost"))
        codes = []
        for _ in range(8):
            verdict = await client.receive("verdict")
            assert verdict["outcome"] == "refused"
            codes.append(verdict["reasons"][0]["code"])
        assert codes == [
            "not_finite",
            "not_finite",
            "bad_shape",
            "stale_cycle",
            "future_cycle",
            "replayed_sequence",
            "lease_not_held",
            "unknown_robot",
        ]
        cycle = await running.peer.turn()  # on a busy machine the state before is too old by now
        client.send(**increment(8, cycle, [0.001] * 6))
        verdict = await client.receive("verdict")
        assert (verdict["outcome"], verdict["seq"], verdict["dq"]) == ("admitted", 8, [0.001] * 6)
        assert running.peer.increments.qsize() == 1


async def test_the_token_of_a_lease_never_leaves_the_server_over_tcp(running: Running) -> None:
    async with json_client(running.port) as client:
        assert (await leased(client))["lease"] is None


async def test_malformed_lines_get_an_error_each_and_the_connection_survives(running: Running) -> None:
    async with json_client(running.port) as client:
        for line in (
            b"",
            b"hello",
            b"[1, 2]",
            b"{}",
            b'{"type": 7}',
            b"\xff\xfe",
            b"[" * 5000,
            b'{"type":"io"}',
        ):
            client.send_bytes(line + b"\n")
            error = await client.receive("error")
            assert error["code"] == "malformed"
            assert error["message"]
        assert (await client.ask("description", type="describe"))["cell"] == "small"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        (b'{"type":"increment","robot":"fr","seq":7}', ("increment", "fr", 7)),
        (b'{"type":"io","robot":"gr","outputs":{"griper":true}}', ("io", "gr", None)),
        (b'{"type":"dry_run","robot":"fr","dq":[0]}', ("dry_run", "fr", None)),
        (b'{"type":"contact","contact":"handshake","allowed":true}', ("contact", None, None)),
        (b'{"type":"view","robot":"gr","distance_m":1.0}', ("view", "gr", None)),
        (b'{"type":"reset","robot":"ghost"}', ("reset", "ghost", None)),
        (b'{"type":"dance","robot":"fr","seq":1}', ("dance", "fr", 1)),
        (b"nonsense", (None, None, None)),
    ],
)
async def test_an_error_names_the_line_that_it_answers(
    running: Running, line: bytes, named: tuple[str | None, str | None, int | None]
) -> None:
    async with json_client(running.port) as client:
        client.send_bytes(line + b"\n")
        error = await client.receive("error")
        assert (error["request"], error["robot"], error["seq"]) == named


async def test_a_hundred_malformed_lines_in_a_row_end_the_connection_and_ninety_nine_do_not(
    running: Running,
) -> None:
    async with json_client(running.port) as client:
        for _ in range(2):
            for _ in range(99):
                client.send_bytes(b"nonsense\n")
            assert (await client.ask("description", type="describe"))["type"] in ("description", "error")
            while (await client.receive("description", "error"))["type"] == "error":
                pass
            client.send(type="describe")
            await client.receive("description")
        for _ in range(100):
            client.send_bytes(b"nonsense\n")
        errors = [await client.receive("error") for _ in range(101)]
        assert "100 malformed lines in a row" in errors[-1]["message"]
        await client.ended()


@pytest.mark.parametrize("end", [b"", b"\n"])
async def test_a_line_longer_than_64_kib_ends_the_connection(running: Running, end: bytes) -> None:
    async with json_client(running.port) as client:
        client.send_bytes(b" " * (MAX_LINE_BYTES + 1) + end)
        assert str(MAX_LINE_BYTES) in (await client.receive("error"))["message"]
        await client.ended()


async def test_a_line_of_exactly_64_kib_is_read(running: Running) -> None:
    async with json_client(running.port) as client:
        line = b'{"type":"describe"}'
        client.send_bytes(line + b" " * (MAX_LINE_BYTES - len(line)) + b"\n")
        assert (await client.receive("description", "error"))["type"] == "description"


@pytest.mark.parametrize("extra", [{}, {"a_field_of_version_2": True}])
async def test_a_client_of_another_version_gets_both_versions_and_is_disconnected(
    running: Running, extra: dict[str, Any]
) -> None:
    async with json_client(running.port, name=None) as client:
        client.send(type="hello", protocol=PROTOCOL_VERSION + 1, client="future", **extra)
        error = await client.receive("error", "welcome")
        assert error["code"] == "protocol_version"
        assert error["message"] == "client speaks protocol 4, this server 1, 2, 3"
        await client.ended()


async def test_before_the_hello_only_a_stop_is_served(running: Running) -> None:
    await running.peer.turn()
    async with json_client(running.port, name=None) as client:
        error = await client.ask("lease", type="lease", robot="fr", action="acquire")
        assert (error["code"], error["request"], error["robot"]) == ("not_permitted", "lease", "fr")
        assert '"type":"hello"' in error["hint"]
        assert (await client.ask("done", type="stop"))["what"] == "stop"
        assert (await running.commanded()).reason is ReasonCode.OPERATOR_STOP


async def test_a_stop_is_obeyed_with_any_other_fields(running: Running) -> None:
    await running.peer.turn()
    async with json_client(running.port) as client:
        assert (await client.ask("done", type="stop", now="please"))["what"] == "stop"


# --- the gate's answers -----------------------------------------------------------------------------


# --- losing and finding one another ------------------------------------------------------------------


async def test_a_controller_that_moved_the_robot_and_is_cut_off_stops_it(running: Running) -> None:
    async with json_client(running.port) as client:
        cycle = await running.peer.turn()
        await leased(client)
        client.send(**increment(1, cycle))
        await client.receive("verdict")
        client.writer.transport.abort()
        command = await running.commanded()
    assert (command.robot, command.reason) == ("fr", ReasonCode.CONTROLLER_LOST)


async def test_nothing_queued_survives_a_reconnect_nor_does_the_lease(running: Running) -> None:
    async with json_client(running.port) as client:
        cycle = await running.peer.turn()
        await leased(client)
        client.send(**increment(1, cycle))
        client.send(**increment(2, cycle))
        await client.receive("verdict")
    await running.commanded()
    async with json_client(running.port) as client:
        cycle = await running.peer.turn(cycles=3)
        client.send(**increment(3, cycle))
        assert (await client.receive("verdict"))["reasons"][0]["code"] == "lease_not_held"
        await leased(client)
        cycle = await running.peer.turn()  # on a busy machine the one before is too old by now
        client.send(**increment(1, cycle))
        await client.receive("verdict")
    assert [running.peer.increments.get_nowait().seq for _ in range(2)] == [1, 1]
    assert running.peer.increments.empty()


async def test_a_client_that_falls_silent_without_closing_loses_its_lease(running: Running) -> None:
    async with json_client(running.port) as silent, json_client(running.port, "next") as following:
        cycle = await running.peer.turn()
        await leased(silent)
        silent.send(**increment(1, cycle))
        await silent.receive("verdict")
        assert (await running.commanded()).reason is ReasonCode.CONTROLLER_LOST
        assert (await leased(following))["holder"] == "next"


@pytest.mark.parametrize(
    "line",
    [
        {"type": "describe"},
        {"type": "io", "robot": "gr"},
        {"type": "dry_run", "robot": "fr", "dq": [0.0]},
        {"type": "lease", "robot": "gr", "action": "renew"},
        {"type": "increment", "robot": "gr", "seq": 1, "cycle": 1, "dq": ZEROS},
        {"type": "increment", "robot": "fr", "seq": 1, "cycle": 1, "dq": [None] * 6},
    ],
    ids=lambda line: str(line.get("action", line["type"])),
)
async def test_any_valid_line_keeps_the_leases_of_its_connection(
    running: Running, line: dict[str, Any]
) -> None:
    async with json_client(running.port) as client:
        await running.peer.turn()
        await leased(client)
        (lease,) = [lease for lease in [running.hli.core._state.leases.of("fr")] if lease]
        before_s = lease.expires_s
        await client.ask("description", "io", "lease", "verdict", **line)
        assert lease.expires_s > before_s


async def test_a_malformed_line_does_not_keep_a_lease(running: Running) -> None:
    async with json_client(running.port) as client:
        await running.peer.turn()
        await leased(client)
        (lease,) = [lease for lease in [running.hli.core._state.leases.of("fr")] if lease]
        before_s = lease.expires_s
        for line in (b"nonsense\n", b'{"type":"io"}\n', b'{"type":"increment","robot":"fr"}\n'):
            client.send_bytes(line)
            await client.receive("error")
        assert lease.expires_s == before_s


async def test_a_restarted_gate_is_found_again(running: Running) -> None:
    await running.peer.turn()
    running.peer.close()
    async with guarded_peer(running.peer.cell) as peer, json_client(running.port) as client:
        cycle = await peer.turn()
        await leased(client)
        client.send(**increment(1, cycle))
        assert (await client.receive("verdict"))["outcome"] == "admitted"
    running.peer = peer


# --- floods and slow readers -------------------------------------------------------------------------


@pytest.mark.long
async def test_a_flood_of_increments_passes_one_a_cycle_without_delaying_others(
    running: Running,
) -> None:
    async with json_client(running.port, "flood") as flood, json_client(running.port) as other:
        first = await running.peer.turn()
        await leased(flood)
        cycles = asyncio.create_task(running.peer.run())
        for seq in range(1, 5001):
            flood.send(**increment(seq, first))
        await running.counted("increments", 10)
        assert running.hli.status().hli["increments"] < 5000
        assert (await other.ask("description", type="describe"))["cell"] == "small"
        await running.counted("increments", 5000)
        cycles.cancel()
        await running.peer.turn()
        assert 1 <= running.peer.increments.qsize() <= running.peer.cycle - first + 1
        counts = running.hli.status().hli
        assert counts["requests"] + counts["refused"] == 5000


@pytest.mark.long
async def test_a_blocked_reader_uses_bounded_memory_and_later_gets_the_newest_state(
    running: Running,
) -> None:
    async with json_client(running.port) as slow:
        slow.writer.transport.pause_reading()
        slow_socket: socket.socket = slow.writer.get_extra_info("socket")
        assert slow_socket.fileno() >= 0
        (connection,) = running.hli._tcp.connections
        while not running.hli.status().hli.get("tcp_states_skipped"):
            for _ in range(50):
                running.peer.cycle += 1
                running.peer.publish_state()
            await asyncio.sleep(0)
        await running.peer.turn(cycles=100)
        assert connection._transport.get_write_buffer_size() < 2**17
        last = await running.peer.turn()
        slow.writer.transport.resume_reading()
        cycles: list[int] = []
        while not cycles or cycles[-1] < last:
            cycles.append((await slow.receive("state"))["cycle"])
        assert cycles[-1] == last
        assert cycles == sorted(cycles)
        assert len(cycles) < last - cycles[0]


async def test_a_client_that_does_not_read_its_answers_is_disconnected(running: Running) -> None:
    async with json_client(running.port) as rude:
        rude.writer.transport.pause_reading()
        answer = len(json.dumps({"type": "describe"}))
        assert answer < MAX_UNREAD_BYTES
        while "tcp_not_reading" not in running.hli.status().hli:
            rude.send_bytes(b'{"type":"describe"}\n' * 100)
            await asyncio.sleep(0.001)
        await running.counted("connections_lost")


async def test_a_refused_client_that_does_not_read_frees_its_place(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_connection, "CLOSE_DEADLINE_S", 0.05)
    async with json_client(running.port) as rude:
        rude.writer.transport.pause_reading()
        (connection,) = running.hli._tcp.connections
        while connection._transport.get_write_buffer_size() < MAX_UNREAD_BYTES // 2:
            rude.send_bytes(b'{"type":"describe"}\n' * 10)
            await asyncio.sleep(0)
        rude.send_bytes(b"nonsense\n" * 100)
        await running.counted("tcp_given_up")
        await running.counted("connections_lost")
        assert not running.hli._tcp.connections


@pytest.mark.long
async def test_a_flood_of_connections_is_refused_and_delays_no_connected_client(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the flood says nothing, and a machine may need longer than the deadline to let all of it in
    monkeypatch.setattr(tcp_connection, "HELLO_DEADLINE_S", 600.0)
    async with json_client(running.port) as client:
        cycle = await running.peer.turn()
        await leased(client)
        flood = []
        for _ in range(10 * MAX_CONNECTIONS):
            _, writer = await asyncio.open_connection("127.0.0.1", running.port)
            flood.append(writer)
        client.send(**increment(1, cycle))
        assert (await client.receive("verdict"))["outcome"] in ("admitted", "refused")
        status = running.hli.status().hli
        assert status["tcp_connections_open"] == MAX_CONNECTIONS
        waiting = (
            10 * MAX_CONNECTIONS + 1 - status["tcp_connections"] - status.get("tcp_connections_given_way", 0)
        )
        assert 0 <= waiting <= MAX_WAITING
        assert status["tcp_connections_refused"] == status["tcp_connections"] - MAX_CONNECTIONS > 0
        for writer in flood:
            writer.close()


async def test_a_connection_beyond_the_limit_is_refused_with_an_error(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_connection, "HELLO_DEADLINE_S", 600.0)
    open_ones = [await asyncio.open_connection("127.0.0.1", running.port) for _ in range(MAX_CONNECTIONS)]
    await running.counted("tcp_connections_open", MAX_CONNECTIONS)
    async with json_client(running.port, name=None) as late:
        assert str(MAX_CONNECTIONS) in (await late.receive("error"))["message"]
        await late.ended()
    for _, writer in open_ones:
        writer.close()
    async with asyncio.timeout(300):
        while running.hli.status().hli.get("tcp_connections_open"):
            await asyncio.sleep(0.005)
    async with json_client(running.port):
        pass


# --- the guarded realm --------------------------------------------------------------------------------


async def test_damaged_messages_from_the_guarded_realm_are_counted_and_nothing_else(running: Running) -> None:
    await running.peer.turn()
    for key in (
        topics.SERVER_STATE.key("small", robot="fr"),
        topics.GATE_VERDICT.key("small", robot="fr"),
        topics.COMMAND_REPLY.key("small"),
        topics.HEALTH.key("small", service="sim"),
    ):
        running.peer.publish_bytes(key, b"\xc1 no message")
    await running.counted("malformed_guarded", 4)
    await running.peer.turn()
