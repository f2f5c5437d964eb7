"""The clients in other languages against a running HLI: what they do, and what they say when they cannot."""

import math
import re
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from languages import LANGUAGES, Language
from octave import command as octave_command
from ran import ran
from served import Server
from small_cell import free_port

from deltaq_protocol.blocking import connect
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.impairment.relay import TrafficUnit
from deltaq_testing.impairment.tcp import StreamFaults
from studies.live_faults.relay_process import RelayProcess

pytestmark = [pytest.mark.service, pytest.mark.long]


@pytest.fixture(params=LANGUAGES, ids=lambda language: language.name)
def language(request: pytest.FixtureRequest) -> Language:
    chosen: Language = request.param
    if why_not := chosen.why_not():
        pytest.skip(why_not)
    return chosen


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as running:
        yield running


def run(language: Language, command: list[str], **variables: str) -> subprocess.CompletedProcess[str]:
    environment = language.environment(**variables)
    return ran(command, env=environment, check=False)


def answers(language: Language, server: Server, *given: Any, **variables: str) -> list[str]:
    """Outcomes that a program was told that answers states of a robot: (robot, compute_s, count)."""
    done = run(language, language.answers(server.description.tcp_port, *given), **variables)
    assert done.returncode == 0, done.stderr
    return done.stdout.partition(":")[2].split()


def refusal(language: Language, done: subprocess.CompletedProcess[str]) -> str:
    """The one line that a program ends with."""
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    if language.name == "octave":  # it adds where it was
        (line,) = (line for line in lines if line.startswith("error: ") and line != "error: called from")
        return re.sub("^error: ", "", line.replace("ignoring const execution_exception&", ""))
    (line,) = lines
    return line


def test_it_turns_a1_by_ten_degrees_and_gives_the_lease_back(language: Language, server: Server) -> None:
    before = server.peer.q_cmd["fr"]
    done = run(language, language.turn_a1(server.description.tcp_port))
    assert done.returncode == 0, done.stderr
    turned = [math.degrees(q - q0) for q, q0 in zip(server.peer.q_cmd["fr"], before, strict=True)]
    assert turned == pytest.approx([10.0, 0, 0, 0, 0, 0], abs=0.1)
    assert "A1 is at 15." in done.stdout  # it began at 0.1 rad
    assert server.hli.status().robots["fr"].lease.holder is None
    assert server.peer.commands.empty()


def test_a_held_robot_ends_the_program_with_the_reason(language: Language, server: Server) -> None:
    server.peer.phases["fr"], server.peer.reasons["fr"] = Phase.HELD, ReasonCode.CONTROLLER_LOST
    done = run(language, language.turn_a1(server.description.tcp_port))
    assert (
        refusal(language, done) == "fr is held: controller_lost; when it is safe, `deltaq reset --robot fr`"
    )


def test_octave_counts_increments_in_flight_in_a_cell_with_a_lookahead() -> None:
    """Left out of account, what is in flight would be asked for again, and the robot would go too far."""
    octave = LANGUAGES[0]
    if why_not := octave.why_not():
        pytest.skip(why_not)
    with Server(gate={"lookahead_cycles": 3}) as server:
        done = run(octave, octave.turn_a1(server.description.tcp_port))
        assert done.returncode == 0, done.stderr
        assert math.degrees(server.peer.q_cmd["fr"][0] - 0.1) == pytest.approx(10.0, abs=0.1)
        largest = max(abs(request.dq[0]) for request in drained(server) if request.dq)
    assert largest <= math.radians(30) * server.description.cycle_s + 1e-12


def test_it_turns_a1_through_a_jitter_buffer_counting_queued_increments(language: Language) -> None:
    """Left out of account, what waits would be asked for again, and the robot would go too far."""
    with ExitStack() as served:
        server, port = served.enter_context(Server()), free_port()
        near = Endpoint.parse(f"tcp/127.0.0.1:{server.description.tcp_port}")
        away = RelayProcess(Endpoint.parse(f"tcp/127.0.0.1:{port}"), near, TrafficUnit.BYTES)
        served.enter_context(away).impair(StreamFaults(delay_s=0.03))
        done = run(language, language.far_turn(port, math.radians(10)))
        assert done.returncode == 0, done.stderr
        assert math.degrees(server.peer.q_cmd["fr"][0] - 0.1) == pytest.approx(10.0, abs=0.1)
    assert int(done.stdout.split()[-1]) >= 5


def drained(server: Server) -> Iterator[Request]:
    while not server.peer.increments.empty():
        yield server.peer.increments.get_nowait()


def test_a_client_that_computes_longer_than_the_greatest_age_is_not_refused(
    language: Language, server: Server
) -> None:
    outcomes = answers(language, server, "fr", 0.15, 8)
    # in answer to the state that they were computed from all would be refused; a busy machine may be late with one
    assert outcomes.count("admitted") > outcomes.count("refused") + 2
    assert server.hli.status().robots["fr"].lease.holder is None


def test_lost_verdicts_do_not_block_the_program(language: Language, server: Server) -> None:
    server.peer.judges = False
    # what a busy machine lets come too late the HLI refuses by itself
    assert set(answers(language, server, "fr", 0.0, 40)) <= {"refused"}
    assert server.peer.increments.qsize() >= 20
    assert server.hli.status().robots["fr"].lease.holder is None


def test_a_client_that_computes_until_its_lease_expires_gets_an_error(
    language: Language, server: Server
) -> None:
    done = run(language, language.answers(server.description.tcp_port, "fr", 1.6, 5))
    assert "the lease of fr has run out" in refusal(language, done)


def test_a_lost_server_gives_one_clear_line(language: Language) -> None:
    with ExitStack() as served:
        server = served.enter_context(Server())
        command = language.answers(server.description.tcp_port, "fr", 0.0, 1_000_000)
        with subprocess.Popen(
            command, env=language.environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as running:
            try:
                asked = server.peer.increments
                while asked.empty():
                    assert running.poll() is None, running.communicate()
                served.close()
                told, errors = running.communicate(timeout=300)
            except BaseException:
                running.kill()
                raise
    done = subprocess.CompletedProcess(command, running.returncode, told, errors)
    assert re.search(r"127\.0\.0\.1:\d+ (does not answer any more|has closed)", refusal(language, done))


def test_a_port_without_a_listener_gives_one_clear_line(language: Language) -> None:
    assert "127.0.0.1:1" in refusal(language, run(language, language.turn_a1(1)))


def test_a_wrong_token_gives_one_clear_line_and_the_environment_gives_the_right_one(
    language: Language,
) -> None:
    with Server("the operator's", "right") as server:
        port = server.description.tcp_port
        wrong = run(language, language.answers(port, "fr", 0.0, 1), DELTAQ_CLIENT_TOKEN="wrong")
        assert "wrong token" in refusal(language, wrong)
        none = run(language, language.answers(port, "fr", 0.0, 1))
        assert "controller's token" in refusal(language, none)
        answers(language, server, "fr", 0.0, 1, DELTAQ_CLIENT_TOKEN="right")


def test_a_token_is_read_from_a_file_and_an_empty_file_gives_one_clear_line(
    language: Language, tmp_path: Path
) -> None:
    right, empty, missing = (tmp_path / name for name in ("right", "empty", "missing"))
    right.write_text("right\n")
    empty.write_text("\n")
    with Server("the operator's", "right") as server:
        answers(
            language, server, "fr", 0.0, 1, DELTAQ_CLIENT_TOKEN_FILE=str(right), DELTAQ_CLIENT_TOKEN="wrong"
        )
        for file, why in (
            (empty, "holds no text"),
            (missing, "cannot be read: .*[Nn]o such file"),
            (tmp_path, "(cannot be read|holds no text)"),
        ):
            command = language.answers(server.description.tcp_port, "fr", 0.0, 1)
            line = refusal(language, run(language, command, DELTAQ_CLIENT_TOKEN_FILE=str(file)))
            assert re.search(f"DELTAQ_CLIENT_TOKEN_FILE: {file} {why}", line)


def test_an_unknown_robot_gives_one_clear_line(language: Language, server: Server) -> None:
    done = run(language, language.answers(server.description.tcp_port, "xy", 0.0, 1))
    assert re.search("cell small has no robot 'xy'; it has fr,? gr", refusal(language, done))


def test_a_server_without_kinematics_gives_one_clear_line(server: Server) -> None:
    octave = LANGUAGES[0]
    if why_not := octave.why_not():
        pytest.skip(why_not)
    done = run(octave, octave_command(f"camera_follower('127.0.0.1', {server.description.tcp_port}, 1)"))
    assert "the server of cell small tells no kinematics" in refusal(octave, done)


def test_a_lease_of_another_client_gives_one_clear_line(language: Language, server: Server) -> None:
    with connect(server.description.hli, client="first") as cell, cell.lease("fr"):
        done = run(language, language.turn_a1(server.description.tcp_port))
        line = refusal(language, done)
        assert "fr" in line
        assert "first" in line
