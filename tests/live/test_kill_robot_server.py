"""`kill -9` of a Robot Server while its arm moves: what is left of it brakes the robot as certified.

What happened is read from the emulated controller's own record.
"""

import os
import select
import signal
from pathlib import Path

import pytest
from live_stack import TIMEOUT_S
from test_kill_in_motion import assert_came_to_rest_along_the_brake

from deltaq_emulator.states import KrcState
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE

pytestmark = pytest.mark.live


def beside(pid):
    """A descriptor of the process that a Robot Server has started."""
    (child,) = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8").split()
    assert "crash_brake" in Path(f"/proc/{child}/cmdline").read_text(encoding="utf-8")
    return os.pidfd_open(int(child))


def assert_goes_on(stack):
    """Started again, the program on the KRC begins a session anew, and the robot moves in it."""
    stack.ask(op="restart")
    stack.launcher.restart("mover")
    stack.wait_for(lambda *_: stack.phase()[0] is not Phase.OFFLINE)
    if stack.phase()[0] is Phase.HELD:
        stack.reset()
    stack.wait_until_moving()
    assert stack.phase()[0] in MAY_MOVE


def test_killing_a_robot_server_brakes_its_robot_and_a_restart_resumes_control(moving_stack):
    stack = moving_stack
    name = "robot-server-fr"
    brake = beside(stack.launcher.children[name].pid)
    killed = stack.kill(name)
    assert select.select([brake], [], [], TIMEOUT_S)[0], "it outlived its robot's brake"
    os.close(brake)
    assert stack.emulator()["state"] != KrcState.RSI_RUNNING, "the stop did not reach the KRC"
    assert_came_to_rest_along_the_brake(stack, killed)
    stack.wait_until_said(name, "its robot was braked")
    stack.launcher.restart(name)
    assert_goes_on(stack)


def test_a_killed_brake_process_is_replaced_and_its_robot_held_until_then(moving_stack):
    stack, name = moving_stack, "robot-server-fr"
    first = beside(stack.launcher.children[name].pid)
    signal.pidfd_send_signal(first, signal.SIGKILL)
    os.close(first)
    stack.wait_for_reason(ReasonCode.CRASH_BRAKE_LOST)
    stack.wait_until_said(name, "was ended by SIGKILL: fr is held while another starts")
    stack.wait_until_said(name, "the process that brakes fr is ready again")
    stack.wait_until_at_rest()
    stack.launcher.restart("mover")
    stack.reset()
    stack.wait_until_moving()
    brake = beside(stack.launcher.children[name].pid)
    killed = stack.kill(name)
    assert select.select([brake], [], [], TIMEOUT_S)[0], "it outlived its robot's brake"
    os.close(brake)
    assert_came_to_rest_along_the_brake(stack, killed)


def test_a_restart_waits_for_the_port_while_the_robot_is_braked(moving_stack):
    stack = moving_stack
    name = "robot-server-fr"
    killed = stack.kill(name)
    stack.launcher.restart(name)
    assert_came_to_rest_along_the_brake(stack, killed)
    assert_goes_on(stack)
