"""Controllers that compute for 150 ms now and then, each as it is printed: no line that was sent to them is lost."""

import contextlib
import json
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ran import ran
from served import Server

from deltaq_services.hli.tcp_connection import TcpConnection
from deltaq_testing.faults import mover

ROOT = Path(__file__).parents[2]
# A controller decodes each line as it takes it up: that is where this one computes, and where it is watched.
SLOWED = """
import json, runpy, sys, time

decode, taken = json.loads, []

def slowly(line):
    taken.append(decode(line))
    if len(taken) % 40 == 0:
        time.sleep(0.15)
    return taken[-1]

json.loads = slowly
sys.argv = sys.argv[1:]
try:
    runpy.run_path(sys.argv[0], run_name="__main__")
finally:
    print("taken", json.dumps(taken))
"""


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as running:
        yield running


@pytest.fixture(autouse=True)
def given(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Cycles of the states that the server had for its client; a busy machine may keep others from the server."""
    cycles: list[int] = []
    deliver = TcpConnection.deliver_state

    def deliver_and_note(self: TcpConnection, robot: str, line: bytes) -> None:
        if self.is_welcome:
            cycles.append(json.loads(line)["cycle"])
        deliver(self, robot, line)

    monkeypatch.setattr(TcpConnection, "deliver_state", deliver_and_note)
    return cycles


def assert_nothing_is_missing(given: list[int], taken: list[dict[str, Any]], increments: int = 20) -> None:
    """What was given has been taken without a gap, and so have the verdicts of so many increments at least."""
    cycles = [message["cycle"] for message in taken if message["type"] == "state"]
    assert len(cycles) > 30
    assert cycles == given[: len(cycles)]
    seqs = {message["seq"] for message in taken if message["type"] == "verdict"}
    assert set(range(1, increments + 1)) <= seqs


def run_slowly(script: Path, *arguments: str) -> list[dict[str, Any]]:
    command = [sys.executable, "-c", SLOWED, str(script), *arguments]
    done = ran(command)
    taken: list[dict[str, Any]] = json.loads(done.stdout.rpartition("taken ")[2])
    return taken


@pytest.mark.service
def test_the_socket_example_handles_every_line_despite_slow_computation(
    server: Server, given: list[int]
) -> None:
    port = str(server.description.tcp_port)
    assert_nothing_is_missing(given, run_slowly(ROOT / "examples" / "over_a_socket.py", "127.0.0.1", port))


@pytest.mark.service
def test_the_controller_of_the_fault_table_handles_every_line_despite_slow_computation(
    monkeypatch: pytest.MonkeyPatch, given: list[int]
) -> None:
    taken: list[dict[str, Any]] = []
    answered: set[int] = set()
    enough, decode = threading.Event(), json.loads

    def slowly(line: str) -> Any:
        message = decode(line)
        taken.append(message)
        if len(taken) % 40 == 0:
            enough.wait(0.15)  # the server in this interpreter goes on meanwhile
        if message["type"] == "verdict":
            answered.add(message["seq"])
        if answered >= set(range(1, 101)):
            enough.set()
        return message

    monkeypatch.setattr(mover, "json", SimpleNamespace(loads=slowly, dumps=json.dumps))
    with Server() as server:
        moving = threading.Thread(target=move_until_cut_off, args=(server.description.tcp_port,))
        moving.start()
        enough.wait(300)
    moving.join()
    assert_nothing_is_missing(given, taken, increments=100)


def move_until_cut_off(port: int) -> None:
    with contextlib.suppress(OSError, ValueError):
        mover._move(port, "fr", 0.0)
