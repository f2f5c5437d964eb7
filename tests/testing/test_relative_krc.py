"""A KRC with RSI_ON(#RELATIVE), where a constant correction is a constant speed: it is found out, and never driven."""

import numpy as np
import pytest

from deltaq_emulator.settings import KrcSettings, OperatingMode
from deltaq_emulator.states import KrcState
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.virtual_cell.cell import VirtualCell

FASTEST = np.full(6, 1e-3)


def cell_with(monkeypatch, cell="lab", **settings):
    changed = KrcSettings.load().model_copy(update=settings)
    monkeypatch.setattr(KrcSettings, "load", lambda: changed)
    return VirtualCell(cell)


def turned_relative_in_motion(monkeypatch):
    """A cell whose floor robot moves as its KRC turns relative, which no real KRC does once probed; and that robot."""
    stack = cell_with(monkeypatch)
    stack.run_until_ready()
    stack.acquire("fr", "test")
    dq = np.zeros(6)
    for _ in range(8):
        stack.cycle()
        dq = np.minimum(dq + FASTEST / 5, FASTEST)
        stack.ask("fr", dq)
    stack.arms["fr"].krc.turn("relative")
    return stack, stack.arms["fr"]


def furthest(stack, robot, cycles):
    """(n,) how far the joints of a robot get from where they are, in so many cycles [rad or m]."""
    start = stack.arms[robot].krc.sample.q
    off = np.zeros_like(start)
    for _ in range(cycles):
        stack.cycle()
        off = np.maximum(off, np.abs(stack.arms[robot].krc.sample.q - start))
    return off


@pytest.mark.long
@pytest.mark.parametrize("cell", ["lab", "lab-4ms"])
def test_a_relative_krc_is_refused_before_any_motion_and_moved_back(monkeypatch, cell):
    stack = cell_with(monkeypatch, cell, correction="relative")
    a_second = round(1.0 / stack.cell.description.cycle_s)
    starts = {name: arm.krc.sample.q for name, arm in stack.arms.items()}
    off = furthest(stack, "gr", a_second)
    assert (off[:3] < 0.035e-3).all()
    assert (off[3:] < np.deg2rad(0.035)).all()
    for name, arm in stack.arms.items():
        assert (arm.server.state.phase, arm.server.state.reason) == (Phase.HELD, ReasonCode.RSI_MODE)
        assert "RSI_ON(#ABSOLUTE)" in arm.server.detail
        assert arm.server.counters["modes_refused"] == arm.server.counters["held_rsi_mode"] == 1
        np.testing.assert_allclose(arm.krc.sample.q, starts[name], atol=1e-6)
    stack.reset("fr")
    assert furthest(stack, "fr", 50).max() < 1e-9
    state = stack.arms["fr"].server.state
    assert (state.phase, state.reason) == (Phase.HELD, ReasonCode.RSI_MODE)


@pytest.mark.long
def test_a_corrected_and_restarted_program_may_be_reset(monkeypatch):
    stack = cell_with(monkeypatch, correction="relative")
    arm = stack.arms["fr"]
    for _ in range(80):
        stack.cycle()
    stack.reset("fr")
    arm.krc.stop()
    for _ in range(30):
        stack.cycle()
    assert arm.server.state.reason is ReasonCode.RSI_MODE  # a KRC that falls silent does not hide it
    arm.krc.restart("absolute")
    for _ in range(100):
        stack.cycle()
    state = arm.server.state
    assert (state.phase, state.reason) == (Phase.HELD, ReasonCode.KRC_LOST)  # by no reset of before
    stack.reset("fr")
    for _ in range(5):
        stack.cycle()
    assert arm.server.state.phase is Phase.READY


@pytest.mark.parametrize("cell", ["lab", "lab-4ms"])
def test_an_absolute_krc_is_ready_within_a_second_without_displacement(monkeypatch, cell):
    stack = cell_with(monkeypatch, cell)
    start = stack.arms["gr"].krc.sample.q
    stack.run_until_ready()
    assert stack.now_s < 1.0
    np.testing.assert_allclose(stack.arms["gr"].krc.sample.q, start, atol=1e-6)


@pytest.mark.long
def test_a_krc_in_t1_is_probed_until_its_motion_is_confirmed(monkeypatch):
    stack = cell_with(monkeypatch, mode=OperatingMode.T1)
    arm = stack.arms["fr"]
    assert furthest(stack, "fr", 100).max() == 0.0
    assert arm.server.state.phase is Phase.OFFLINE
    assert arm.server.detail.startswith("a1, a2, a3, a4, a5, a6 did not follow the mode probe")
    arm.krc.confirm()
    for _ in range(150):
        stack.cycle()
    assert (arm.server.state.phase, arm.server.detail) == (Phase.READY, "")


@pytest.mark.long
def test_a_krc_that_sends_one_decimal_is_not_driven(monkeypatch):
    stack = cell_with(monkeypatch, precision=1)
    for _ in range(200):
        stack.cycle()
    assert stack.arms["fr"].server.state.phase is Phase.OFFLINE
    assert "four decimals" in stack.arms["fr"].server.detail


@pytest.mark.long
def test_motion_after_the_brake_holds_the_robot_and_sends_the_stop_signal(monkeypatch):
    stack, arm = turned_relative_in_motion(monkeypatch)
    held = 0
    while not arm.server.motion_stop:
        stack.cycle()
        held += 1
    assert held < 30
    assert arm.server.state.reason is ReasonCode.TRACKING_ERROR
    stack.reset("fr")
    for _ in range(20):
        stack.cycle()
        assert arm.server.state.phase is Phase.HELD
        assert arm.server.motion_stop


@pytest.mark.long
def test_after_the_stop_signal_a_corrected_program_may_be_reset(monkeypatch):
    stack, arm = turned_relative_in_motion(monkeypatch)
    while arm.krc.state is not KrcState.MOTION_ENDED:
        stack.cycle()
    for _ in range(30):
        stack.cycle()
    arm.krc.restart("absolute")
    for _ in range(100):
        stack.cycle()
    assert arm.krc.state is KrcState.RSI_RUNNING
    assert arm.server.state.phase is Phase.HELD
    stack.reset("fr")
    for _ in range(5):
        stack.cycle()
    assert arm.server.state.phase is Phase.READY
