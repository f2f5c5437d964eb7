"""Relays over real sockets and zenoh sessions: they carry everything, until they are told not to."""

import asyncio
import socket
from contextlib import asynccontextmanager, suppress
from tempfile import TemporaryDirectory

import pytest
import zenoh
from small_cell import endpoint, free_port

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.session import open_session
from deltaq_testing.impairment.relay import TrafficUnit, relay
from deltaq_testing.impairment.tcp import StreamFaults
from studies.live_faults.relay_process import RelayProcess

HERE = "127.0.0.1"


def tcp() -> Endpoint:
    return Endpoint.parse(endpoint())


@asynccontextmanager
async def echo_behind_a_relay(unit):
    """A server that sends back what comes, a relay before it, and a client of the relay."""

    async def echo(reader, writer):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
        writer.close()

    listen, to = tcp(), tcp()
    server = await asyncio.start_server(echo, HERE, to.port)
    async with server, relay(listen, to, unit, seed=1) as running:
        reader, writer = await asyncio.open_connection(HERE, listen.port)
        yield running, reader, writer
        writer.transport.abort()


async def test_a_relay_carries_megabytes_both_ways_and_the_end_of_the_connection():
    async with asyncio.timeout(300), echo_behind_a_relay(TrafficUnit.BYTES) as (_, reader, writer):
        sent = bytes(range(256)) * 20_000
        writer.write(sent)
        writer.write_eof()
        assert await reader.read(-1) == sent


@pytest.mark.parametrize("unit", [TrafficUnit.BYTES, TrafficUnit.MESSAGES])
async def test_a_relay_connects_unix_sockets(unit):
    """Two zenoh sessions, as HLI and SIM are; what comes over the relay is as it was."""
    with TemporaryDirectory(dir="/tmp") as folder:
        to, listen = (Endpoint("unixsock-stream", f"{folder}/{name}.sock", 0) for name in ("sim", "relay"))
        assert Endpoint.parse(str(listen)) == listen
        listener = open_session(listen=[str(to)])
        came = listener.declare_subscriber("**", zenoh.handlers.RingChannel(8))
        async with asyncio.timeout(300), relay(listen, to, unit, seed=1):
            speaker = await asyncio.to_thread(open_session, connect=[str(listen)], must_connect=True)
            while (sample := came.try_recv()) is None:
                speaker.put("deltaq-guarded/lab/command", b"said")
                await asyncio.sleep(0.01)
            speaker.close()
        assert (str(sample.key_expr), sample.payload.to_bytes()) == ("deltaq-guarded/lab/command", b"said")
        listener.close()


async def test_a_stalled_wire_delivers_its_bytes_after_the_stall():
    async with asyncio.timeout(300), echo_behind_a_relay(TrafficUnit.BYTES) as (running, reader, writer):
        writer.write(b"before")
        assert await reader.readexactly(6) == b"before"
        running.impair(StreamFaults(stalled=True))
        writer.write(b"during")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await reader.read(1)
        running.impair(StreamFaults())
        assert await reader.readexactly(6) == b"during"


async def test_a_stalled_wire_blocks_its_sender_and_does_not_fill_the_memory():
    async with asyncio.timeout(300), echo_behind_a_relay(TrafficUnit.BYTES) as (running, _, writer):
        running.impair(StreamFaults(stalled=True))
        writer.write(b"x" * 40_000_000)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await writer.drain()
        (carrier, _) = sorted(running._carriers, key=lambda c: -c._direction.waiting_bytes)
        assert 0 < carrier._direction.waiting_bytes < 2**21


async def test_a_cut_breaks_the_connection_and_refuses_new_ones_until_its_end():
    async with asyncio.timeout(300), echo_behind_a_relay(TrafficUnit.BYTES) as (running, reader, writer):
        writer.write(b"x")
        await reader.readexactly(1)
        running.impair(StreamFaults(cut=True))
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await reader.readexactly(1)
        port = writer.get_extra_info("peername")[1]
        refused, refused_writer = await asyncio.open_connection(HERE, port)
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await refused.readexactly(1)
        refused_writer.transport.abort()
        running.impair(StreamFaults())
        again, to_relay = await asyncio.open_connection(HERE, port)
        to_relay.write(b"y")
        assert await again.readexactly(1) == b"y"
        to_relay.transport.abort()


async def test_a_missing_server_ends_the_connection_of_the_client():
    listen = tcp()
    async with asyncio.timeout(300), relay(listen, tcp(), TrafficUnit.BYTES):
        reader, writer = await asyncio.open_connection(HERE, listen.port)
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await reader.readexactly(1)
        writer.close()


async def test_lines_are_lost_and_the_connection_lives():
    async with asyncio.timeout(300), echo_behind_a_relay(TrafficUnit.LINES) as (running, reader, writer):
        running.impair(LinkFaults(drop=0.5))
        writer.write(b"".join(b"%d\n" % k for k in range(400)))
        running.impair(LinkFaults(drop=0.5))
        writer.write(b"end\n" * 40)
        arrived = []
        while (line := await reader.readline()) != b"end\n":
            arrived.append(int(line))
        assert arrived == sorted(arrived)
        assert 40 < len(arrived) < 200  # a half of a half


async def test_datagrams_of_several_senders_are_carried_and_answered_separately():
    loop = asyncio.get_running_loop()
    with socket.socket(type=socket.SOCK_DGRAM) as server:
        server.bind((HERE, 0))
        server.setblocking(False)
        to = Endpoint("udp", HERE, server.getsockname()[1])
        listen = Endpoint("udp", HERE, free_port())
        async with asyncio.timeout(300), relay(listen, to, TrafficUnit.DATAGRAMS, seed=2) as running:
            with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as other:
                for sender in (one, other):
                    sender.setblocking(False)
                    sender.connect((HERE, listen.port))
                for text, sender in ((b"one", one), (b"other", other)):
                    sender.send(text)
                    data, address = await loop.sock_recvfrom(server, 100)
                    assert data == text
                    server.sendto(b"answer to " + data, address)
                    assert await loop.sock_recv(sender, 100) == b"answer to " + text
                running.impair(LinkFaults(drop=0.5, duplicate=1.0))
                arrived = []
                for k in range(100):
                    one.send(str(k).encode())
                while not arrived or arrived[-1] < 90:
                    arrived += [int(await loop.sock_recv(server, 100)) for _ in range(2)]
                assert arrived[::2] == arrived[1::2]  # whatever is not lost comes twice
                assert 25 < len(arrived[::2]) < 75


async def test_zenoh_messages_are_carried_both_ways_and_duplicated_one_by_one():
    listen, to = tcp(), tcp()
    server = open_session(listen=[str(to)])
    async with asyncio.timeout(300), relay(listen, to, TrafficUnit.MESSAGES) as running:
        client = await asyncio.to_thread(open_session, connect=[str(listen)])
        try:
            heard = {
                name: session.declare_subscriber(
                    "deltaq/*", zenoh.handlers.FifoChannel(1000), allowed_origin=zenoh.Locality.REMOTE
                )
                for name, session in (("server", server), ("client", client))
            }
            for name, session in (("server", client), ("client", server)):
                arrived = None
                while arrived is None:  # until the sessions have found one another
                    session.put("deltaq/x", name.encode())
                    await asyncio.sleep(0.01)
                    arrived = heard[name].try_recv()
                assert arrived.payload.to_bytes() == name.encode()
            running.impair(LinkFaults(duplicate=1.0))
            client.put("deltaq/y", b"both")
            payloads = []
            while payloads.count(b"both") < 2:
                sample = await asyncio.to_thread(heard["server"].recv)
                payloads.append(sample.payload.to_bytes())
            assert payloads[-2:] == [b"both", b"both"]
        finally:
            client.close()
            server.close()


@pytest.mark.service
def test_a_relay_process_obeys_and_a_used_port_is_reported():
    listen, to = tcp(), tcp()
    with (
        socket.create_server((HERE, to.port)) as server,
        RelayProcess(listen, to, TrafficUnit.BYTES) as running,
    ):
        with (
            pytest.raises(ServiceUnreachableError, match=f"cannot listen on {listen}"),
            RelayProcess(listen, to, TrafficUnit.BYTES),
        ):
            pass
        with socket.create_connection((HERE, listen.port), timeout=300) as client:
            there, _ = server.accept()
            there.settimeout(300)
            running.impair(StreamFaults(stalled=True))
            client.sendall(b"late")
            running.impair(StreamFaults())
            assert there.recv(100) == b"late"
            running.impair(StreamFaults(cut=True))
            with suppress(ConnectionResetError):
                assert there.recv(100) == b""
            there.close()
