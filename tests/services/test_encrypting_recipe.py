"""The page's recipe for clients without TLS: `socat` in front of them. Skipped where it is not installed."""

import asyncio
import contextlib
import re
import shlex
import shutil
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from certificate import certificate
from guarded_peer import guarded_peer
from json_client import JsonClient, json_client
from small_cell import free_port, small_cell, told, tool_pose

from deltaq_protocol.proof import line_proof
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.line_encryption import line_encryption
from deltaq_services.hli.shell import Hli

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "talk-over-a-socket.md"
TOKEN = "0123456789abcdef-operator"

pytestmark = pytest.mark.skipif(shutil.which("socat") is None, reason="socat is not installed")


def printed(local_port: int, hli_port: int, trusted: str) -> list[str]:
    """The page's command, on a machine that is both ends."""
    (line,) = re.findall(r"^socat .*$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    changes = (
        ("TCP-LISTEN:5210,", f"TCP-LISTEN:{local_port},"),
        ("192.0.2.1:5210", f"127.0.0.1:{hli_port}"),
        ("cafile=lines.pem", f"cafile={trusted}"),
    )
    for shown, here in changes:
        assert line.count(shown) == 1, line
        line = line.replace(shown, here)
    return shlex.split(line)


@contextlib.asynccontextmanager
async def in_front(hli_port: int, trusted: str) -> AsyncIterator[int]:
    """The port of a `socat` that runs as the page says, once it listens; `-d -d` makes it say so."""
    port = free_port()
    program, *options = printed(port, hli_port, trusted)
    running = await asyncio.create_subprocess_exec(
        program, "-d", "-d", *options, stderr=asyncio.subprocess.PIPE, start_new_session=True
    )
    assert running.stderr is not None
    try:
        said = b""
        while b"listening on" not in said:
            said = await running.stderr.readline()
            assert said, "it ended"
        yield port
    finally:
        running.terminate()
        await running.communicate()


@contextlib.asynccontextmanager
async def encrypted(folder: Path) -> AsyncIterator[tuple[int, str]]:
    """Port of an HLI with encrypted lines, and its certificate's path."""
    files, cell = certificate(folder), small_cell()
    encryption = line_encryption(cell, files)
    async with (
        guarded_peer(cell) as peer,
        Hli(cell, told(cell), tool_pose, ClientRoles(TOKEN), encryption),
    ):
        await peer.turn()
        yield cell.tcp_port, files["DELTAQ_LINES_CERTIFICATE_FILE"]


async def greeted(client: JsonClient) -> bool:
    """Whether who speaks in the clear to `socat` is welcome at the HLI, by its token."""
    challenge = (await client.ask("challenge", type="challenge"))["challenge"]
    proof = line_proof(TOKEN, challenge)
    hello = {"type": "hello", "protocol": 3, "client": "matlab", "challenge": challenge, "proof": proof}
    return (await client.ask("welcome", **hello))["type"] == "welcome"


async def test_the_printed_tunnel_connects_a_client_without_tls(tmp_path: Path) -> None:
    async with (
        encrypted(tmp_path) as (hli_port, trusted),
        in_front(hli_port, trusted) as port,
        json_client(port, name=None) as client,
    ):
        assert await greeted(client)
        assert (await client.ask("lease", type="lease", robot="fr", action="take"))["granted"]


async def test_the_tunnel_refuses_an_hli_with_another_certificate(tmp_path: Path) -> None:
    """The attack: somebody else listens where the HLI should be."""
    (tmp_path / "other").mkdir()
    other = certificate(tmp_path / "other")["DELTAQ_LINES_CERTIFICATE_FILE"]
    async with (
        encrypted(tmp_path) as (hli_port, _),
        in_front(hli_port, other) as port,
        json_client(port, name=None) as client,
    ):
        client.send(type="challenge")
        await client.ended()
