"""An emulated KRC that adds corrections up, or ticks otherwise, as a process, before a whole cell of real processes."""

from dataclasses import replace

import numpy as np
import pytest
from live_stack import live_stack

from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.services import Role
from deltaq_emulator.settings import SHIPPED
from deltaq_protocol import blocking, topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.envelope import message_in
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.guarded import Health
from deltaq_protocol.messages import Phase
from deltaq_protocol.session import subscribe_newest
from deltaq_services.guarded_realm import open_watching_session
from deltaq_services.robot_server.probe_trial import PROBE_RAD

pytestmark = pytest.mark.live


def relative(services, file):
    """The floor robot's KRC runs a program that calls RSI_ON(#RELATIVE)."""
    settings = file.with_name("relative.yaml")
    text = SHIPPED.read_text(encoding="utf-8")
    settings.write_text(text.replace("correction: absolute", "correction: relative"), encoding="utf-8")
    return [
        replace(service, arguments=(*service.arguments, "--settings", str(settings)))
        if service.role is Role.EMULATOR and service.robot == "fr"
        else service
        for service in services
    ]


def at_4_ms(services, file):
    """The floor robot's KRC ticks every 4 ms, and its drives are so quick that no probe of theirs fails by that."""
    quick = file.with_name("quick.yaml")
    lag = "{dead_time_s: 0.004, natural_frequency_rad_s: 1500}"
    robot = f"{{driver: {{krc: krc4}}, servo_lag: {lag}}}"
    quick.write_text(f"extends: {file.name}\ncycle_s: 0.004\nrobots: {{fr: {robot}}}\n", encoding="utf-8")
    return [
        replace(
            service,
            arguments=tuple(str(quick) if one == str(file) else one for one in service.arguments),
        )
        if service.role is Role.EMULATOR and service.robot == "fr"
        else service
        for service in services
    ]


def detail(stack):
    """What the floor robot's Robot Server tells people."""
    session = open_watching_session(stack.cell, "robot-server-fr")
    try:
        health = subscribe_newest(session, topics.HEALTH.key(stack.cell.cell, service="robot-server-fr"))
        sample = health.recv()
        return unpack(Health, message_in(sample.payload.to_bytes())).detail
    finally:
        session.close()


@pytest.mark.nightly  # by day in virtual time: tests/testing/test_relative_krc.py
def test_a_krc_in_relative_mode_is_never_driven(tmp_path):
    with live_stack(tmp_path, rewired=relative) as stack:
        assert stack.emulator()["correction"] == "relative"
        stack.wait_for_reason("rsi_mode")
        assert "let the program call RSI_ON(#ABSOLUTE)" in detail(stack)
        with (
            connect(stack.cell, "test") as running,
            pytest.raises(RefusedError, match=r"RSI_ON\(#ABSOLUTE\)"),
        ):
            running.reset("fr")
        stack.wait_cycles(50)
        assert stack.phase() == (Phase.HELD, "rsi_mode")
        _, setpoints = stack.setpoints()
        away = np.degrees(np.abs(setpoints - stack.robot.home).max())
        print(f"the arm moved {away:.4f} deg in all")
        assert 0.02 < away < 0.1
        # where a reply was missed this KRC adds the one before once more, or none: so much is not undone
        off = 1e-6 + PROBE_RAD * stack.unanswered()
        np.testing.assert_allclose(setpoints[-1], stack.robot.home, atol=off)


@pytest.mark.nightly  # by day in virtual time: tests/testing/test_krc_cycle.py
def test_a_krc_that_ticks_three_times_as_fast_as_its_cell_is_never_driven(tmp_path):
    with live_stack(tmp_path, rewired=at_4_ms) as stack:
        stack.wait_for_reason("cycle_mismatch")
        assert "the KRC ticks every 4.0 ms by its IPOC" in detail(stack)
        stack.wait_until_said("robot-server-fr", "the cell says 12.0 ms")
        with (
            connect(stack.cell, "test") as running,
            pytest.raises(RefusedError, match="does not tick with the cell's cycle"),
        ):
            running.reset("fr")
        stack.wait_cycles(100)
        assert stack.krc_cycle_s == pytest.approx(0.004)
        _, setpoints = stack.setpoints()
        assert np.abs(np.diff(setpoints, axis=0)).max() == 0.0


def test_a_krc_that_turns_relative_in_motion_is_told_to_stop_and_comes_to_rest(tmp_path):
    with live_stack(tmp_path) as stack:
        hli = stack.cell.hli
        with blocking.connect(hli) as cell, cell.lease("fr") as robot:
            for _, _state in zip(range(12), robot.states(), strict=False):
                robot.move([5e-4, 0, 0, 0, 0, 0])
        stack.wait_until_at_rest()
        before = stack.setpoint()
        assert np.degrees(before[0] - stack.robot.home[0]) > 0.1
        turned = stack.ask(op="fault", correction="relative")["cycle"]
        ended = stack.ask(op="await", state="ready", at_rest=True, within_s=10)
        assert ended["message"] == "RSI_MOVECORR was ended by the signal Stop"
        away = np.degrees(np.abs(stack.setpoint() - before).max())
        print(f"the arm went on {away:.3f} deg, and rested {ended['cycle'] - turned} cycles later")
        assert 1.0 < away < 5.0
