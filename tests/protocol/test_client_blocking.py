"""The blocking client, as a script uses it: the HLI runs in another thread's loop."""

import re
import sys
import threading
from collections.abc import Iterator

import pytest
from ran import ran
from served import Server
from small_cell import REVOLUTE, endpoint

from deltaq_protocol.blocking import BlockingCell, connect
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Outcome
from deltaq_protocol.reasons import ReasonCode

DQ = (0.001,) * 6


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with Server() as running:
        yield running


@pytest.fixture
def cell(server: Server) -> Iterator[BlockingCell]:
    with connect(server.description.hli, client="script") as connected:
        yield connected


def client_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "deltaq client"]


def test_a_script_without_a_running_cell_ends_with_one_line() -> None:
    script = f"from deltaq_protocol.blocking import connect\nwith connect({endpoint()!r}): pass\n"
    done = ran([sys.executable, "-c", script], check=False)
    assert done.returncode == 1
    assert re.fullmatch(r"error: no server answers at .*\n", done.stderr)


def test_connecting_without_a_listener_fails_and_leaves_no_thread() -> None:
    with pytest.raises(ServiceUnreachableError), connect(endpoint()):
        pass
    assert client_threads() == []


def test_a_script_answers_states_and_gets_the_admitted_increments(cell: BlockingCell) -> None:
    with cell.lease("fr") as robot:
        verdicts = [robot.move(DQ) for _, state in zip(range(5), robot.states(), strict=False)]
        assert robot.state is not None
    assert [(verdict.seq, verdict.outcome) for verdict in verdicts] == [
        (seq, Outcome.ADMITTED) for seq in range(1, 6)
    ]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_leaving_by_an_error_or_an_interrupt_releases_the_lease(
    cell: BlockingCell, server: Server, error: type[BaseException]
) -> None:
    def controller() -> None:
        with cell.lease("fr") as robot:
            robot.move(DQ)
            raise error

    with pytest.raises(error):
        controller()
    assert cell.status().robots["fr"].lease.holder is None
    assert server.peer.commands.empty()


def test_leaving_ends_the_thread_though_an_iterator_is_still_open(server: Server) -> None:
    with connect(server.description.hli) as cell:
        states = cell.states("fr")
        verdicts = cell.verdicts("fr")
        assert next(states).robot == "fr"
        with cell.lease("fr") as robot:
            robot.move(DQ)
            robot.move(DQ)
        assert client_threads() != []
    assert client_threads() == []
    del verdicts


def test_stop_reset_io_and_status_have_blocking_forms(cell: BlockingCell, server: Server) -> None:
    assert cell.stop().what == "stop"
    assert cell.reset("fr").what == "reset fr"
    assert cell.robots["gr"].joints[0] == "e1"
    assert cell.description.cell == "small"
    assert cell.state("gr") is None
    with cell.lease("gr") as robot:
        assert robot.io({"gripper": True}).outputs == {"gripper": True}
    while not server.peer.commands.empty():
        server.peer.commands.get_nowait()


CHANGER = {
    "model": "kr16",
    "driver": {
        "kind": "rsi", "address": "127.0.0.1", "port": 49152, "ethernet_xml": "fr.xml", "krc": "krc2",
        "outputs": {"opens": "Do.O1"}, "inputs": {"locked": "Di.I1"},
    },
    "joints": {f"a{k}": REVOLUTE for k in range(1, 7)},
    "outputs": ["opens"],
    "inputs": ["locked"],
    "tools": {"key": {"frame": {"position_m": [0, 0, 0.2]}}},
    "tool_changer": {"release": "opens", "locked": "locked"},
}  # fmt: skip


def test_a_tool_is_coupled_when_a_state_says_so_and_the_description_tells_it() -> None:
    with Server(robots={"fr": CHANGER}) as server, connect(server.description.hli) as cell:
        with cell.lease("fr") as robot:
            assert robot.couple("key").coupled == "key"
            assert cell.description.coupled == {"fr": "key"}
            with pytest.raises(RefusedError, match="no tool 'kee'; fr has key"):
                robot.couple("kee")
            server.peer.refuses = ReasonCode.CLEARANCE
            with pytest.raises(RefusedError, match="tool of fr refused"):
                robot.couple(None)
            server.peer.refuses, server.peer.obeys = None, True
        with connect(server.description.hli) as other:
            assert other.description.coupled == {"fr": "key"}, "asked after the change"


def test_a_non_blocking_script_sends_one_increment_a_state_and_gets_every_verdict(
    cell: BlockingCell,
) -> None:
    with cell.lease("fr") as robot:
        verdicts = robot.verdicts()
        sent = [robot.send(DQ) for _, state in zip(range(30), robot.states(), strict=False)]
        got = [next(verdicts) for _ in sent]
    assert sorted(verdict.seq for verdict in got) == sent == list(range(1, 31))


def test_a_revoked_lease_raises_at_the_next_increment_of_a_script(cell: BlockingCell) -> None:
    with cell.lease("fr", client="first") as first:
        first.move(DQ)
        with (
            cell.lease("fr", client="second", take=True),
            pytest.raises(RefusedError, match="second holds it now"),
        ):
            first.move(DQ)


def test_sending_without_a_lease_or_connection_raises(server: Server) -> None:
    cell = connect(server.description.hli, client="notebook").open()
    with cell.lease("fr") as robot:
        robot.send(DQ)
    with pytest.raises(RefusedError, match="was released"):
        robot.send(DQ)
    cell.close()
    with pytest.raises(ServiceUnreachableError, match="connection was closed"):
        cell.status()


def test_a_notebook_closes_cell_and_lease_and_no_thread_remains(cell: BlockingCell, server: Server) -> None:
    before = client_threads()
    notebook = connect(server.description.hli, client="notebook").open()
    robot = notebook.lease("fr").open()
    robot.move(DQ)
    assert cell.status().robots["fr"].lease.holder == "notebook"
    robot.close()
    robot.close()
    assert cell.status().robots["fr"].lease.holder is None
    robot = notebook.lease("fr").open()
    robot.send(DQ)
    notebook.close()
    robot.close()
    notebook.close()
    assert cell.status().robots["fr"].lease.holder is None
    assert client_threads() == before
    assert server.peer.commands.empty()


BLOCKING = """
import sys
from deltaq_protocol.blocking import connect
cell = connect(sys.argv[1], client="forgetful").open()
robot = cell.lease("fr").open()
for state, _ in zip(robot.states(), range(5)):
    robot.send([0.001] * 6)
print(cell.status().robots["fr"].lease.holder)
"""

ASYNC = """
import asyncio, sys
from deltaq_protocol import connect

async def main():
    cell = await connect(sys.argv[1], client="forgetful").open()
    robot = await cell.lease("fr").open()
    print((await robot.move([0.001] * 6)).outcome, (await cell.status()).robots["fr"].lease.holder)

"""
SCRIPTS = {
    "blocking": BLOCKING,
    "blocking, an error": BLOCKING + "raise SystemExit(0)",
    "asyncio.run": ASYNC + "asyncio.run(main())",
    # a task that is pending when its loop is forgotten is told by asyncio itself, whosever task it is
    "a loop that is left as it is": ASYNC
    + "import logging; logging.disable()\nasyncio.new_event_loop().run_until_complete(main())",
}


@pytest.mark.service
@pytest.mark.parametrize("script", SCRIPTS.values(), ids=SCRIPTS.keys())
def test_an_unclosed_lease_is_released_silently_at_exit(
    cell: BlockingCell, server: Server, script: str
) -> None:
    command = [sys.executable, "-c", script, server.description.hli]
    done = ran(command, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "forgetful" in done.stdout
    assert cell.status().robots["fr"].lease.holder is None
    assert server.peer.commands.empty()
