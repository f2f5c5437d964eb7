"""The examples run as they are, each against a running HLI, and do what they say."""

import math
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from ran import ran
from served import Server

from deltaq_protocol.blocking import connect
from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode

HELD = "fr is held: controller_lost; when it is safe, `deltaq reset --robot fr`"
EXAMPLES = Path(__file__).parents[2] / "examples"
CLIENTS = sorted(path.name for path in EXAMPLES.glob("*.py") if not path.name.startswith("gate_"))
"""The others need no HLI; `tests/protocol/test_gate_alone.py` runs them."""


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as running:
        yield running


def arguments(example: str, server: Server) -> list[str]:
    cell = server.description
    return [cell.tcp_address, str(cell.tcp_port)] if example == "over_a_socket.py" else [cell.hli]


def run(example: str, *given: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLES / example), *given]
    return ran(command, check=False)


def assert_it_turns_a1_by_ten_degrees_and_gives_the_lease_back(example: str, server: Server) -> None:
    before = server.peer.q_cmd["fr"]
    done = run(example, *arguments(example, server))
    assert (done.returncode, done.stderr) == (0, "")
    turned = [math.degrees(q - q0) for q, q0 in zip(server.peer.q_cmd["fr"], before, strict=True)]
    assert turned == pytest.approx([10.0, 0, 0, 0, 0, 0], abs=0.1)
    assert "A1 is at 15." in done.stdout  # it began at 0.1 rad
    assert server.hli.status().robots["fr"].lease.holder is None
    assert server.peer.commands.empty()
    largest = max(abs(request.dq[0]) for request in drained(server) if request.dq)
    assert largest <= math.radians(30) * server.description.cycle_s + 1e-12


@pytest.mark.service
@pytest.mark.parametrize("example", CLIENTS)
def test_the_example_turns_a1_by_ten_degrees_and_releases_the_lease(example: str, server: Server) -> None:
    assert_it_turns_a1_by_ten_degrees_and_gives_the_lease_back(example, server)


@pytest.mark.service
def test_the_non_blocking_example_counts_increments_in_flight_with_a_lookahead() -> None:
    """Left out of account, what is in flight would be asked for again, and the robot would go too far."""
    with Server(gate={"lookahead_cycles": 3}) as server:
        assert_it_turns_a1_by_ten_degrees_and_gives_the_lease_back("without_waiting.py", server)


def drained(server: Server) -> Iterator[Request]:
    while not server.peer.increments.empty():
        yield server.peer.increments.get_nowait()


@pytest.mark.service
@pytest.mark.parametrize("example", CLIENTS)
def test_the_example_ends_at_a_held_robot_with_the_reason(example: str, server: Server) -> None:
    server.peer.phases["fr"], server.peer.reasons["fr"] = Phase.HELD, ReasonCode.CONTROLLER_LOST
    done = run(example, *arguments(example, server))
    assert (done.returncode, done.stderr) == (1, f"{HELD}\n")


@pytest.mark.service
def test_the_socket_example_is_refused_while_another_client_holds_the_lease(server: Server) -> None:
    with connect(server.description.hli, client="first") as cell, cell.lease("fr"):
        done = run("over_a_socket.py", *arguments("over_a_socket.py", server))
    assert done.returncode == 1
    assert "lease_taken" in done.stderr


@pytest.mark.parametrize("example", sorted(path.name for path in EXAMPLES.glob("*.py")))
def test_the_example_declares_its_dependencies_as_inline_metadata(example: str) -> None:
    lines = (EXAMPLES / example).read_text().splitlines()
    block = lines[lines.index("# /// script") + 1 : lines.index("# ///")]
    metadata = tomllib.loads("\n".join(line.removeprefix("# ") for line in block))
    assert metadata["requires-python"] == ">=3.11"
    needs = metadata["dependencies"]
    if example.startswith("gate_"):
        assert needs[0] == "deltaq[cell]"
    else:
        assert needs == ([] if example == "over_a_socket.py" else ["deltaq"])
