"""The floods that are measured: which there are, and what a row says."""

from __future__ import annotations

import asyncio
import ssl

import pytest
from guarded_peer import guarded_peer
from json_client import json_client
from small_cell import small_cell, told, tool_pose

from deltaq_proofs.floods.__main__ import _line
from deltaq_proofs.floods.attacks import ATTACKS
from deltaq_proofs.floods.line_attacks import _client_hello
from deltaq_proofs.floods.measure import FloodFigures, FloodRow
from deltaq_services.hli.shell import Hli


def test_the_list_has_every_kind_of_flood() -> None:
    said = " ".join(ATTACKS)
    for kind in ("lines", "increments", "oversized", "without an end", "connections", "handshakes", "stops"):
        assert kind in said
    for kind in ("leases", "statuses", "proven", "replayed", "slow readers", "do not read"):
        assert kind in said
    assert [name for name, attack in ATTACKS.items() if attack.encrypted] == ["handshakes"]


def test_a_row_tells_states_braked_cycles_and_how_long_a_stop_took() -> None:
    row = FloodRow(
        "lines",
        1234.5,
        FloodFigures(166.0, 1, 1.0),
        FloodFigures(83.0, 20, 0.9),
        0.5,
        (0.0214, None, 0.02),
        (),
        (0.0654,),
    )
    assert _line(row).split() == [
        "lines",
        "1234",
        "166",
        "->",
        "83",
        "50.0%",
        "1",
        "->",
        "20",
        "21,",
        "inf",
        "-",
        "65,",
        "65",
    ]


def test_a_handshake_is_begun_as_tls_begins_one() -> None:
    hello = _client_hello()
    assert (hello[0], hello[5]) == (22, 1)  # a record of a handshake, a ClientHello
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    incoming.write(hello)
    with pytest.raises(ssl.SSLError, match="NO_SHARED_CIPHER"):  # without a certificate; it was understood
        context.wrap_bio(incoming, outgoing, server_side=True).do_handshake()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # an attacker closes nothing
@pytest.mark.parametrize(
    "name", ["lines", "increments over lines", "oversized lines", "lines without an end", "connections"]
)
async def test_each_flood_of_lines_is_one_that_the_hli_hears_and_outlives(name: str) -> None:
    cell = small_cell(lease_s=5.0)
    async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose):
        await peer.turn()
        cycles = asyncio.create_task(peer.run())
        step = await asyncio.to_thread(ATTACKS[name].begin, cell)
        for _ in range(3):
            await asyncio.to_thread(step)
        async with json_client(cell.tcp_port) as client:
            assert (await client.ask("description", type="describe"))["cell"] == "small"
        cycles.cancel()
