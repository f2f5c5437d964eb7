"""The live cell of the plug-in: real processes on ports of their own, one cell for all tests of a session."""

import pytest

# pytester forgets what a run imported, and C extensions cannot be imported twice
import deltaq_testing.live  # noqa: F401
from deltaq_testing.live import LiveCell
from deltaq_testing.schedule import ScheduleError, fault

PROGRAM = """
import json, socket, sys
server = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
def say(**message):
    server.sendall(json.dumps(message).encode() + b"\\n")
say(type="hello", protocol=1, client="program")
say(type="lease", robot="fr", action="acquire")
seq, before = 0, None
for line in server.makefile():
    state = json.loads(line)
    if state["type"] == "state" and state["robot"] == "fr":
        seq += 1
        q = state["q_cmd"][0]
        # as fast as a brake takes some cycles from: on a busy machine a cycle without an increment is no rest
        dq = min(0.01, 0.0004 + (0 if before is None else q - before))
        before = q
        say(type="increment", robot="fr", seq=seq, cycle=state["cycle"], dq=[dq, 0, 0, 0, 0, 0])
"""
TESTS = """
import sys
import numpy as np
import pytest
from deltaq_testing.schedule import fault

seen = []

def test_gate_dies(live_cell):
    seen.append(live_cell)
    live_cell.drive_process([sys.executable, "program.py", "{port}"])
    live_cell.suffer(fault("sim_dead", at_s=2.0, for_s=1.0))
    live_cell.run(5.0)
    assert live_cell.q[0] > live_cell.home[0] + 0.05
    assert live_cell.reason == "gate_lost"
    assert live_cell.rested_within(cycles=40)
    assert live_cell.kept_clear()
    assert live_cell.recover()

def test_stop_on_the_same_cell(live_cell):
    assert seen == [live_cell]
    live_cell.run(0.2)
    assert np.abs(live_cell.q - live_cell.home).max() < 1e-3
    live_cell.drive_process([sys.executable, "program.py", "{port}"])
    live_cell.suffer(fault("operator_stop", at_s=1.5))
    live_cell.run(3.0)
    assert live_cell.reason == "operator_stop"
    assert live_cell.rested_within(cycles=40)
    assert not live_cell.rested_within(cycles=0)
    assert live_cell.kept_clear()
"""


@pytest.mark.nightly
@pytest.mark.live
def test_a_test_session_has_one_live_cell_that_is_made_ready_between_tests(pytester):
    pytester.makepyfile(program=PROGRAM, test_live=TESTS)
    result = pytester.runpytest(
        "-p", "deltaq_testing.plugin", "-p", "no:asyncio", "-p", "no:cacheprovider", "test_live.py"
    )
    result.assert_outcomes(passed=2)


@pytest.mark.parametrize("name", ["link_cut", "hli_clock_forward", "controller_dead", "controller_leap"])
def test_a_fault_that_needs_virtual_time_is_refused_live(name):
    with pytest.raises(
        ScheduleError, match="cannot be injected into a live cell under test; take virtual_cell"
    ):
        LiveCell.suffer(object.__new__(LiveCell), fault(name, at_s=1.0))
