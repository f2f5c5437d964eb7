"""A link that loses and delays packets, with the kernel's own TCP and UDP over it."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import pytest
from networks import why_none
from ran import ran

from deltaq_emulator.faults import LinkFaults
from studies.two_sites.packets import PacketLink, PacketLinkError, within
from studies.two_sites.sites import (
    CONTROLLER_ADDRESS,
    HLI_ADDRESS,
    OFFICE_ADDRESS,
    ROBOTS_ADDRESS,
    Sites,
    sites,
)

pytestmark = [pytest.mark.nightly, pytest.mark.skipif(bool(why_none()), reason=why_none())]


@asynccontextmanager
async def linked(**faults: float) -> AsyncIterator[tuple[Sites, PacketLink]]:
    with sites() as made:
        async with PacketLink(made.controller, made.office, seed=3) as link:
            made.connect_wide_area()
            link.impair(LinkFaults(**faults))
            yield made, link


def udp(namespace: str, address: str) -> socket.socket:
    with within(namespace):
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    made.bind((address, 5000))
    return made


async def test_packets_arrive_as_late_as_they_shall_and_some_do_not() -> None:
    loop = asyncio.get_running_loop()
    async with linked(delay_s=0.03, jitter_s=0.02, drop=0.2) as (made, link):
        with udp(made.controller, CONTROLLER_ADDRESS) as near, udp(made.office, HLI_ADDRESS) as far:
            sent: dict[int, float] = {}
            late_s: dict[int, float] = {}

            async def receive() -> None:
                while True:
                    number = int(await loop.sock_recv(far, 100))
                    late_s[number] = time.monotonic() - sent[number]

            async def all_have_come() -> None:
                while len(late_s) + link.ways[0].counts["dropped"] < 300:
                    await asyncio.sleep(0.01)

            receiving = asyncio.create_task(receive())
            for number in range(300):
                sent[number] = time.monotonic()
                near.sendto(b"%d" % number, (HLI_ADDRESS, 5000))
                await asyncio.sleep(0.001)
            await asyncio.wait_for(all_have_come(), 300)
            receiving.cancel()
    assert min(late_s.values()) >= 0.03
    assert 180 <= len(late_s) <= 285  # of 300, seldom beyond, whatever the seed
    assert sum(value >= 0.035 for value in late_s.values()) > 100


async def test_tcp_delivers_all_of_it_in_order_over_a_link_that_loses_packets() -> None:
    async with linked(delay_s=0.002, drop=0.05) as (made, link):
        text = b"".join(b"%06d " % number for number in range(20_000))
        heard = bytearray()
        done = asyncio.Event()

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            while data := await reader.read(65536):
                heard.extend(data)
            writer.close()
            done.set()

        with within(made.office):
            server = await asyncio.start_server(serve, HLI_ADDRESS, 5001)
        with within(made.controller):
            client = socket.socket()
        client.setblocking(False)
        await asyncio.get_running_loop().sock_connect(client, (HLI_ADDRESS, 5001))
        _, writer = await asyncio.open_connection(sock=client)
        writer.write(text)
        writer.write_eof()
        async with asyncio.timeout(300):
            await done.wait()
        writer.close()
        server.close()
        await server.wait_closed()
        assert bytes(heard) == text
        assert sum(way.counts["dropped"] for way in link.ways) > 0


async def test_a_cut_cable_lets_nothing_pass_until_it_is_mended() -> None:
    loop = asyncio.get_running_loop()
    with sites() as made, udp(made.robots, ROBOTS_ADDRESS) as near, udp(made.office, OFFICE_ADDRESS) as far:

        async def passes(text: bytes) -> None:
            near.sendto(text, (OFFICE_ADDRESS, 5000))
            async with asyncio.timeout(0.3):
                while await loop.sock_recv(far, 100) != text:
                    pass

        async def passes_in_the_end(text: bytes) -> None:
            """The first may wait for the neighbour's address."""
            async with asyncio.timeout(300):
                while True:
                    with suppress(TimeoutError):
                        return await passes(text)

        await passes_in_the_end(b"before")
        made.cut()
        with pytest.raises(TimeoutError):
            await passes(b"cut")
        made.mend()
        await passes_in_the_end(b"after")


def test_networks_are_gone_after_the_block_and_of_no_use_before() -> None:
    with sites() as made:
        assert made.robots in ran(["ip", "netns"]).stdout
    assert made.robots not in ran(["ip", "netns"]).stdout
    with pytest.raises(PacketLinkError, match=made.robots), within(made.robots):
        pytest.fail("there is no such network")
