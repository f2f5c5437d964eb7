"""Controllers that are programs of their own: virtual time waits for them, and only for them."""

import sys

import pytest
from ramps import STEP_RAD

from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.line_controller import ControllerProcess, ControllerProcessError, LineController
from deltaq_testing.schedule import fault
from deltaq_testing.virtual import CellUnderTest

PROGRAM = f"""
import json, socket, sys, time
server = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
lines = server.makefile()
def say(**message):
    server.sendall(json.dumps(message).encode() + b"\\n")
say(type="hello", protocol=1, client="program")
assert json.loads(lines.readline())["type"] == "welcome"
say(type="lease", robot="fr", action="acquire")
seq = 0
for line in lines:
    message = json.loads(line)
    if message["type"] == "state":
        seq += 1
        {{each_state}}
        say(type="increment", robot="fr", seq=seq, cycle=message["cycle"], dq=[{STEP_RAD}, 0, 0, 0, 0, 0])
"""


@pytest.fixture(scope="module")
def lab():
    return load_rsi_cell("lab")


@pytest.fixture
def cell(lab):
    cell = CellUnderTest(lab)
    yield cell
    cell.close()


def program(each_state="pass"):
    return [sys.executable, "-c", PROGRAM.format(each_state=each_state), "{port}"]


@pytest.mark.long
def test_every_state_is_answered_by_a_program_of_any_slowness(cell):
    cell.drive_process(program("time.sleep(0.05 * (seq == 5))"))
    cell.run(0.5)
    assert cell.verdicts == {"admitted": 40, "scaled": 2}
    assert cell.phase == "engaged"


@pytest.mark.long
def test_a_program_and_an_equal_function_give_the_same_run(lab, cell):
    cut = fault("link_cut", at_s=0.2, for_s=0.1)
    cell.drive_process(program())
    function = CellUnderTest(lab)
    function.drive(lambda state: [STEP_RAD, 0, 0, 0, 0, 0])
    for one in (cell, function):
        one.suffer(cut)
        one.run(0.6)
    assert [list(q) for q in cell.history["fr"].setpoints] != [list(cell.q)] * len(cell.history["fr"].q)
    assert abs(cell.q - function.q).max() < 2 * STEP_RAD  # the one asks for its lease a state earlier


@pytest.mark.long
def test_a_killed_program_is_restarted(cell):
    cell.drive_process(program())
    cell.suffer(fault("controller_dead", at_s=0.2, for_s=0.2))
    cell.run(0.5)
    assert cell.reason == "controller_lost"
    assert cell.recover()
    before = cell.q[0]
    cell.run(0.5)
    assert cell.q[0] > before + 20 * STEP_RAD


def test_a_lease_renewal_is_an_answer_too(cell):
    cell.drive_process(program("say(type='lease', robot='fr', action='renew'); continue"))
    cell.run(0.3)
    assert not cell.verdicts
    assert cell.phase == "ready"


def test_malformed_lines_are_refused_and_the_run_continues(cell):
    cell.drive_process(
        program("server.sendall([b'{}', b'[1', b'{\"type\": 3}'][seq % 3] + b'\\n'); continue")
    )
    cell.run(0.3)
    assert cell.refusals["malformed"] > 20


def test_an_ended_program_is_a_lost_controller(cell):
    cell.drive_process(program("sys.exit() if seq == 10 else None"))
    cell.run(0.3)
    assert cell.reason == "controller_lost"
    assert cell.phase == "held"


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "told"),
    [
        (["/nowhere/program"], "/nowhere/program cannot be started: No such file or directory"),
        (
            [sys.executable, "-c", "raise SystemExit(3)"],
            "did not connect within 0.5 s: it (still runs|ended with status 3)",
        ),
        (
            program("continue"),
            "said nothing for 20 s after the state of cycle [0-9]+; a controller in virtual time",
        ),
        ([], "command must name a program, got an empty list"),
    ],
    ids=["no program", "ends", "silent", "nothing"],
)
def test_a_silent_program_ends_the_run_with_a_remedy(cell, command, told):
    # to connect, a program on a busy machine may need longer than nobody waits for one that has ended
    patience_s = 20.0 if "said nothing" in told else 0.5

    def run():
        impatient = ControllerProcess(command, patience_s=patience_s)
        cell._programs.append(impatient)
        cell.connect(lambda say: LineController("fr", impatient, cell.note, cell.close, say))
        cell.run(0.2)

    with pytest.raises(ControllerProcessError, match=told):
        run()
