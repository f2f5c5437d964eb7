"""JSON lines over TLS, with a certificate as the page tells to make one, and the client that it prints."""

import asyncio
import contextlib
import socket
import ssl
from collections.abc import AsyncIterator

import pytest
from certificate import certificate
from guarded_peer import GuardedPeer, guarded_peer
from json_client import JsonClient
from small_cell import small_cell, told, tool_pose

from deltaq_services.hli import newcomers, places, tcp_connection, tcp_front
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.line_encryption import line_encryption
from deltaq_services.hli.places import (
    MAX_WAITING,
    MAX_WAITING_OF_A_PEER,
    WaitingPlaces,
)
from deltaq_services.hli.shell import Hli

TOKEN = "an operator's token"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return certificate(tmp_path_factory.mktemp("certificate"))


@contextlib.asynccontextmanager
async def encrypted(files: dict[str, str]) -> AsyncIterator[tuple[Hli, GuardedPeer]]:
    """An HLI whose lines are encrypted."""
    cell = small_cell(clients_need_tokens=True)
    encryption = line_encryption(cell, files)
    async with (
        guarded_peer(cell) as peer,
        Hli(cell, told(cell), tool_pose, ClientRoles(TOKEN), encryption) as hli,
    ):
        await peer.turn()
        yield hli, peer


async def test_a_client_over_tls_is_served_like_one_without(files: dict[str, str]) -> None:
    trusted = ssl.create_default_context(cafile=files["DELTAQ_LINES_CERTIFICATE_FILE"])
    async with encrypted(files) as (_, peer):
        port = peer.cell.tcp_port
        with pytest.raises(ssl.SSLCertVerificationError):
            await asyncio.open_connection("127.0.0.1", port, ssl=ssl.create_default_context())
        reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=trusted, limit=2**22)
        client = JsonClient(reader, writer)
        await client.ask("welcome", type="hello", protocol=1, client="tls", token=TOKEN)
        assert (await client.ask("lease", type="lease", robot="fr", action="take"))["granted"]
        cycle = await peer.turn()
        client.send(type="increment", robot="fr", seq=1, cycle=cycle, dq=[0.0] * 6)
        assert (await client.receive("verdict"))["outcome"] == "admitted"
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def test_unencrypted_or_silent_connections_to_an_encrypted_port_are_closed(
    files: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (newcomers, tcp_front):
        monkeypatch.setattr(module, "HANDSHAKE_S", 0.2)
    async with encrypted(files) as (hli, peer):
        port = peer.cell.tcp_port
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        with socket.create_connection(("127.0.0.1", port)):
            writer.write(b'{"type":"hello","protocol":1,"client":"clear"}\n')
            await JsonClient(reader, writer).ended()
            assert not hli._tcp.connections
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def test_of_unencrypted_lines_only_a_stop_is_obeyed(
    files: dict[str, str],
) -> None:
    async with encrypted(files) as (hli, peer):
        reader, writer = await asyncio.open_connection("127.0.0.1", peer.cell.tcp_port)
        client = JsonClient(reader, writer)
        writer.write(b'{"type":"hello","protocol":1,"client":"x"}\n{"type":"stop"}\n{"type":"describe"}\n')
        assert (await client.receive("done"))["what"] == "stop"
        assert (await peer.commands.get()).kind == "stop"
        assert not hli._tcp.connections
        assert hli.status().hli["tcp_connections"] == 1
        assert await reader.read() == b""
        writer.close()


async def test_of_too_many_unencrypted_stops_the_oldest_is_closed(
    files: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(places, "MAX_STOP_PLACES", 1)
    monkeypatch.setattr(tcp_connection, "STOP_DEADLINE_S", 300.0)
    async with encrypted(files) as (_, peer), contextlib.AsyncExitStack() as stack:
        readers = []
        for _ in range(2):
            reader, writer = await asyncio.open_connection("127.0.0.1", peer.cell.tcp_port)
            stack.callback(writer.close)
            await JsonClient(reader, writer).ask("done", type="stop")
            readers.append(reader)
        assert await readers[0].read() == b""
        assert not readers[1].at_eof()


async def test_pending_tls_handshakes_do_not_delay_an_unencrypted_stop(
    files: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_front, "_HANDSHAKES_A_SECOND", 0.0)  # as if so many had been taken up already
    begun = ssl.create_default_context().wrap_bio(
        ssl.MemoryBIO(), first := ssl.MemoryBIO(), server_hostname="x"
    )
    with contextlib.suppress(ssl.SSLWantReadError):
        begun.do_handshake()
    hello = first.read()
    async with encrypted(files) as (_, peer), contextlib.AsyncExitStack() as stack:
        for _ in range(2 * MAX_WAITING):
            _, writer = await asyncio.open_connection("127.0.0.1", peer.cell.tcp_port)
            stack.callback(writer.close)
            writer.write(hello)
        reader, writer = await asyncio.open_connection("127.0.0.1", peer.cell.tcp_port)
        stack.callback(writer.close)
        await JsonClient(reader, writer).ask("done", type="stop")
        assert (await peer.commands.get()).kind == "stop"


@pytest.mark.long
async def test_pending_tls_handshakes_do_not_lock_out_a_client(
    files: dict[str, str],
) -> None:
    """The attack: connections that say nothing. Each one more than there are places ends the oldest."""
    trusted = ssl.create_default_context(cafile=files["DELTAQ_LINES_CERTIFICATE_FILE"])
    async with encrypted(files) as (_, peer), contextlib.AsyncExitStack() as stack:
        port = peer.cell.tcp_port
        silent = []
        for _ in range(MAX_WAITING + 20):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            stack.callback(writer.close)
            silent.append(reader)
        reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=trusted, limit=2**22)
        stack.callback(writer.close)
        client = JsonClient(reader, writer)
        await client.ask("welcome", type="hello", protocol=1, client="late", token=None)
        await client.ask("done", type="stop")
        assert (await peer.commands.get()).kind == "stop"
        for reader in silent[:20]:  # those that were there first
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
        assert not silent[-1].at_eof()


def test_a_flood_closes_its_own_connections_and_one_from_many_addresses_the_oldest() -> None:
    places: WaitingPlaces[str] = WaitingPlaces()
    assert places.take("stop", "192.0.2.1") is None
    for n in range(10 * MAX_WAITING):
        gave_way = places.take(f"flood {n}", "192.0.2.66")
        older = n - MAX_WAITING_OF_A_PEER
        assert gave_way == (None if older < 0 else f"flood {older}")
    for n in range(10 * MAX_WAITING):
        assert places.take(f"here {n}", "127.0.0.1") != "stop"
        assert len(places) <= MAX_WAITING
    places.leave("stop")
    places.leave("stop")
    assert places.take("again", "192.0.2.1") is None
    assert places.take("one more", "192.0.2.1") not in (None, "again")


def test_addresses_take_turns_with_their_newest_connection_first() -> None:
    places: WaitingPlaces[str] = WaitingPlaces()
    for one, address in (("a1", "192.0.2.1"), ("b1", "192.0.2.2"), ("b2", "192.0.2.2"), ("b3", "192.0.2.2")):
        places.take(one, address)
    assert list(places) == ["b3", "a1", "b2", "b1"]
    places.leave("b3")
    assert list(places) == ["b2", "a1", "b1"]
