"""The HLI as a process of its own."""

import asyncio
import contextlib
import itertools
import json
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from json_client import JsonClient, json_client
from small_cell import endpoint, free_port

from deltaq_protocol import connect
from deltaq_protocol.audit import AuditEntry

pytestmark = pytest.mark.service


def cell_file(folder: Path, tcp_port: int) -> tuple[Path, str]:
    """The lab cell on ports that nobody listens on."""
    hli = endpoint()
    file = folder / "here.yaml"
    file.write_text(
        f"extends: lab\nhli: {hli}\nsim: {endpoint()}\ntcp_port: {tcp_port}\n"
        f"robots:\n  fr:\n    server: {endpoint()}\n  gr:\n    server: {endpoint()}\n"
    )
    return file, hli


@asynccontextmanager
async def process(*arguments: str, **environment: str) -> AsyncIterator[asyncio.subprocess.Process]:
    started = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "deltaq_services.hli",
        *arguments,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=os.environ | environment,
    )
    try:
        yield started
    finally:
        if started.returncode is None:
            started.kill()
        await started.communicate()


async def test_the_process_reports_ready_serves_both_fronts_and_ends_cleanly(tmp_path: Path) -> None:
    port = free_port()
    file, hli = cell_file(tmp_path, port)
    for number in (signal.SIGTERM, signal.SIGINT):
        async with process("--cell", str(file)) as started:
            assert started.stdout is not None
            line = (await asyncio.wait_for(started.stdout.readline(), 300)).decode()
            assert line.startswith("ready: hli of lab")
            async with connect(hli) as cell, json_client(port) as client:
                assert set(cell.robots) == {"fr", "gr"}
                assert "<robot" in cell.description.urdf["fr"]
                welcome = await client.ask("welcome", type="hello", protocol=1, client="again")
                assert welcome["robots"]["gr"]["units"][:3] == ["m"] * 3
                description = await client.ask("description", type="describe")
                assert description["yaml"] == cell.description.yaml
                started.send_signal(number)
                out, err = await asyncio.wait_for(started.communicate(), 300)
            assert (started.returncode, out, err) == (0, b"", b"")


async def test_the_log_is_one_object_a_line_without_tokens(tmp_path: Path) -> None:
    port, token, guess = free_port(), "the-operators-token", "a-guessed-token"
    file, hli = cell_file(tmp_path, port)
    told: list[str] = []
    environment = {"DELTAQ_LOG_FORMAT": "json", "DELTAQ_OPERATOR_TOKEN": token}
    async with process(
        "--cell", str(file), "--audit", str(tmp_path / "audit.jsonl"), **environment
    ) as started:
        assert started.stdout is not None
        ready = await asyncio.wait_for(started.stdout.readline(), 300)
        wrong: list[dict[str, object]] = [
            {"type": "hello", "protocol": 1, "client": "stranger", "token": guess},
            {"type": "hello", "protocol": 1, "token": token},
            {"type": "hello", "protocol": 1, "client": "me", "token": [token]},
            {"type": "hello", "protocol": 1, "client": "me", "tokn": token},
            {"type": {"token": token}},
            {"type": "lease", "token": token},
        ]
        for line in wrong:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(json.dumps(line).encode() + b"\n")
            told.append((await asyncio.wait_for(reader.readline(), 300)).decode())
            writer.close()
        async with connect(hli, token=token) as cell:
            await cell.status()
        started.send_signal(signal.SIGTERM)
        out, err = await asyncio.wait_for(started.communicate(), 300)
    lines = [json.loads(line) for line in (ready + out + err).splitlines()]
    assert {(line["service"], line["robot"]) for line in lines} == {("hli", None)}
    assert lines[0]["message"].startswith("ready: hli of lab")
    assert any("a wrong token from 127.0.0.1" in line["message"] for line in lines)
    everything = "".join([*told, str(lines), (tmp_path / "audit.jsonl").read_text()])
    assert all("error" in answer for answer in told)
    for secret in (token, guess):
        assert secret not in everything


async def test_a_used_port_ends_the_process_with_status_3_and_its_number(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        async with process("--cell", str(cell_file(tmp_path, port)[0])) as started:
            _, err = await asyncio.wait_for(started.communicate(), 300)
    assert started.returncode == 3
    assert str(port).encode() in err
    assert b"Traceback" not in err


async def test_a_missing_cell_ends_the_process_with_status_2() -> None:
    async with process("--cell", "nowhere") as started:
        _, err = await asyncio.wait_for(started.communicate(), 300)
    assert started.returncode == 2
    assert b"nowhere" in err
    assert b"Traceback" not in err


@pytest.mark.nightly
async def test_kill_9_in_a_flood_leaves_whole_lines_in_the_audit_log_and_the_next_process_appends(
    tmp_path: Path,
) -> None:
    port, log = free_port(), tmp_path / "audit.jsonl"
    command = ("--cell", str(cell_file(tmp_path, port)[0]), "--audit", str(log))
    before = b""
    for name in ("first", "second"):
        async with process(*command, DELTAQ_OPERATOR_TOKEN="s3cret") as started:
            assert started.stdout is not None
            await asyncio.wait_for(started.stdout.readline(), 300)
            async with json_client(port, name) as client:

                async def flood(client: JsonClient = client) -> None:
                    for number in itertools.count():
                        client.send(type="lease", robot=f"ghost-{number}", action="take", token="guess")
                        await client.writer.drain()

                flooding = asyncio.create_task(flood())
                async with asyncio.timeout(300):
                    while len(log.read_bytes()) < len(before) + 2000:
                        await asyncio.sleep(0.001)
                started.kill()
                await started.wait()
                with contextlib.suppress(OSError):
                    await flooding
        now = log.read_bytes()
        assert now.startswith(before)
        assert now.endswith(b"\n")
        entries = [AuditEntry.model_validate_json(line) for line in now[len(before) :].splitlines()]
        assert (entries[0].what, entries[0].client) == ("connected", name)
        assert entries[1].what == "lease_refused"
        assert b"guess" not in now
        before = now


async def test_with_required_tokens_unencrypted_links_are_warned_of_with_field_and_remedy(
    tmp_path: Path,
) -> None:
    file, hli = cell_file(tmp_path, free_port())
    elsewhere = hli.replace("127.0.0.1", "0.0.0.0")
    text = file.read_text().replace(hli, elsewhere)
    file.write_text(f"{text}clients_need_tokens: true\n")
    tokens = {f"DELTAQ_{role}_TOKEN": f"{role} 0123456789abcdef" for role in ("OPERATOR", "CONTROLLER")}
    async with process("--cell", str(file), **tokens) as started:
        assert started.stdout is not None
        said = []
        while not (said and "ready:" in said[-1]):
            said.append((await started.stdout.readline()).decode())
            assert said[-1], "it ended"
        started.terminate()
        _, errors = await started.communicate()
    told = "".join(said) + errors.decode()
    assert f"hli ({elsewhere}): " in told
    assert "put a tunnel between the machines" in told
