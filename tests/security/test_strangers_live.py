"""All attacks of a stranger together on a running cell; where the system allows, it is a process of another user."""

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from live_stack import TIMEOUT_S, live_stack

from deltaq_deploy.launch.cell_connection import connect
from deltaq_emulator.states import KrcState
from deltaq_protocol.messages import Phase
from deltaq_services.guarded_key import guarded_seal, key_file_of_launch, realm_of
from deltaq_testing.faults.panel import recovery

pytestmark = [pytest.mark.live, pytest.mark.timeout(300)]

NOBODY = 65534
PROGRAM = Path(__file__).parents[1] / "support" / "stranger.py"


class Attacker:
    """The stranger's process."""

    def __init__(self, process):
        self._process = process
        self.uid = json.loads(process.stdout.readline())["uid"]

    def does(self, what):
        self._process.stdin.write(what + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())


@contextmanager
def attacker(cell_file):
    user = [str(NOBODY)] if os.geteuid() == 0 else []
    command = [sys.executable, str(PROGRAM), str(cell_file), *user]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Attacker(process)
        process.stdin.close()
        assert process.wait(60) == 0


def say_until(counted, what, stack, stranger):
    deadline = time.monotonic() + TIMEOUT_S
    with connect(stack.cell, "test") as running:
        while not counted(running.status()):
            assert time.monotonic() < deadline, running.status()
            stranger.does(what)
            stack.wait_cycles(2)
        return running.status()


def test_nothing_that_a_stranger_says_moves_frees_or_confuses_a_running_cell(tmp_path):
    with live_stack(tmp_path) as stack, attacker(tmp_path / "private.yaml") as stranger:
        assert stranger.uid == (NOBODY if os.geteuid() == 0 else os.geteuid())
        file = key_file_of_launch(realm_of(stack.cell))
        assert guarded_seal(stack.cell)
        if stranger.uid != os.geteuid():
            assert stranger.does(f"try {file}") == "PermissionError"

        # a motion for it to record
        with connect(stack.cell, "test") as running, running.lease("fr") as robot:
            for _, _state in zip(range(12), robot.states(), strict=False):
                robot.move([5e-4, 0, 0, 0, 0, 0])
        stack.wait_until_at_rest()
        assert stranger.does("record") > 100

        # while the cell may move: nothing moves, nothing is set
        before = stack.setpoint()
        status = say_until(counted_everywhere, "forge", stack, stranger)
        assert status.contacts == ()
        assert [robot.phase for robot in status.robots.values()] == [Phase.READY] * 2
        assert not [name for name in status.gate if name.startswith("command_")]
        assert status.robots["fr"].counters["admissions"] == admissions(stack)
        np.testing.assert_array_equal(stack.setpoint(), before)

        # what the operator stops stays stopped
        with connect(stack.cell, "test") as running:
            running.stop()
            held = running.status()
        status = say_until(lambda now: forged(now) > forged(held) + 20, "forge", stack, stranger)
        for robot in status.robots.values():
            assert (robot.phase, robot.reason) == (Phase.HELD, "operator_stop")

        # a recording of all this moves no robot whose server has just started
        stack.launcher.restart("robot-server-fr")
        stranger.does("repeat")
        stack.wait_until_it_leaves(KrcState.RSI_RUNNING)  # it misses the one that ended
        for request in recovery(stack.emulator()["state"]):
            stack.ask(**request)
        stranger.does("repeat")
        stack.wait_for_reason("server_lost")
        status = say_until(unbound, "repeat", stack, stranger)
        assert status.robots["fr"].phase is Phase.HELD
        assert status.contacts == ()
        np.testing.assert_allclose(stack.setpoint(), before, atol=1e-3)  # the new session is probed

        # and the operator's reset still counts
        stack.reset()
        assert stack.phase()[0] is Phase.READY
        with connect(stack.cell, "test") as running:
            seen = running.status().gate
        assert not [name for name in seen if name.startswith("impossible_states")]


def admissions(stack):
    with connect(stack.cell, "test") as running:
        return running.status().robots["fr"].counters["admissions"]


def forged(status):
    return status.gate.get("forged_messages", 0)


def unbound(status):
    return status.robots["fr"].counters.get("unbound_admission")


def counted_everywhere(status):
    return forged(status) and all(
        robot.counters.get("forged_admission") and robot.counters.get("forged_supervision")
        for robot in status.robots.values()
    )
