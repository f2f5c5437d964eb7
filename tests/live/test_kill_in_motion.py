"""`kill -9` of the controller, the HLI and the SIM while the arm moves: real processes, zenoh and UDP.

What happened is read from the emulated controller's own record.
"""

import numpy as np
import pytest

from deltaq_services.phases import MAY_MOVE
from deltaq_testing.oracle import TELEGRAM_STEP

pytestmark = pytest.mark.live


def assert_came_to_rest_along_the_brake(stack, killed_in_cycle):
    """Deceleration within limits, no jump, no limit passed, one straight line, and no longer than it must be."""
    cycle_s, robot = stack.krc_cycle_s, stack.robot
    cycles, setpoints = stack.setpoints()
    assert (np.diff(cycles) == 1).all()
    after = setpoints[killed_in_cycle - cycles[0] - 2 :]
    steps = np.diff(after, axis=0)
    rest = int(np.flatnonzero(np.any(steps != 0, axis=1))[-1]) + 1
    assert np.all(setpoints >= robot.lower)
    assert np.all(setpoints <= robot.upper)
    assert np.all(np.abs(steps) <= robot.max_velocity * cycle_s + 2 * TELEGRAM_STEP)
    unanswered = stack.unanswered()
    changes = np.abs(np.diff(steps, axis=0))
    beyond = np.any(changes > robot.max_acceleration * cycle_s**2 + 4 * TELEGRAM_STEP, axis=1)
    # a reply that the network or the machine lost shows as a stop and a start, and is counted by the controller
    assert int(beyond.sum()) <= 3 * unanswered
    # only A1 moved, so the straight line of the brake is A1 alone
    assert np.all(np.abs(after[:, 1:] - after[0, 1:]) <= TELEGRAM_STEP)
    speed = np.abs(steps[:rest, 0])
    brake_s = speed.max() / cycle_s / robot.max_acceleration[0]
    noticed_s = 0.5
    assert rest * cycle_s < brake_s + noticed_s
    braking = speed[int(np.flatnonzero(speed >= speed.max() - TELEGRAM_STEP)[-1]) :]
    assert (np.diff(braking) < 2 * TELEGRAM_STEP).sum() >= len(braking) - 1 - unanswered


def assert_work_goes_on(stack, restart_mover=True):
    if restart_mover:
        stack.launcher.restart("mover")
    stack.wait_until_moving()
    assert stack.phase()[0] in MAY_MOVE


def test_killing_the_controller_brakes_and_holds_until_a_reset(moving_stack):
    stack = moving_stack
    killed = stack.kill("mover")
    stack.wait_until_at_rest()
    assert_came_to_rest_along_the_brake(stack, killed)
    stack.wait_for_reason("controller_lost")
    stack.reset()
    assert_work_goes_on(stack)


def test_killing_the_hli_brakes_and_holds_until_a_restart_and_reset(moving_stack):
    stack = moving_stack
    killed = stack.kill("hli")
    stack.wait_until_at_rest()
    assert_came_to_rest_along_the_brake(stack, killed)
    stack.launcher.restart("hli")
    stack.wait_for_reason("hli_lost")
    stack.reset()
    assert_work_goes_on(stack)


def test_killing_the_gate_brakes_and_holds_until_a_restart_and_reset(moving_stack):
    stack = moving_stack
    killed = stack.kill("sim")
    stack.wait_until_at_rest()
    assert_came_to_rest_along_the_brake(stack, killed)
    stack.wait_for_reason("gate_lost")
    stack.launcher.restart("sim")
    stack.reset()
    assert_work_goes_on(stack, restart_mover=False)  # it went on sending, and so kept its lease
