"""The blocking client, as a script uses it: the HLI runs in another thread's loop."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from served import Server
from small_cell import endpoint

from deltaq_protocol.blocking import BlockingCell, connect
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Outcome

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


def test_where_nobody_listens_connecting_fails_and_no_thread_stays() -> None:
    with pytest.raises(ServiceUnreachableError), connect(endpoint()):
        pass
    assert client_threads() == []


def test_a_script_answers_states_and_gets_back_what_was_admitted(cell: BlockingCell) -> None:
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


def test_a_lease_held_by_another_is_refused(cell: BlockingCell) -> None:
    with cell.lease("fr", client="first"), pytest.raises(RefusedError, match="first"), cell.lease("fr"):
        pass


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


def test_stop_reset_io_and_status_have_their_blocking_twins(cell: BlockingCell, server: Server) -> None:
    assert cell.stop().what == "stop"
    assert cell.reset("fr").what == "reset fr"
    assert cell.robots["gr"].joints[0] == "e1"
    assert cell.description.cell == "small"
    assert cell.state("gr") is None
    with cell.lease("gr") as robot:
        assert robot.io({"gripper": True}).outputs == {"gripper": True}
    while not server.peer.commands.empty():
        server.peer.commands.get_nowait()
