"""An emulated KRC that adds corrections up, or ticks otherwise, as a process, before a whole cell of real processes."""

from dataclasses import replace

import numpy as np
import pytest
from live_stack import live_stack

from deltaq_deploy.launch.services import Role
from deltaq_emulator.settings import SHIPPED
from deltaq_protocol import blocking, topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.envelope import message_in
from deltaq_protocol.guarded import Health
from deltaq_protocol.session import subscribe_newest
from deltaq_services.guarded_realm import open_watching_session

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


def detail(stack):
    """What the floor robot's Robot Server tells people."""
    session = open_watching_session(stack.cell, "robot-server-fr")
    try:
        health = subscribe_newest(session, topics.HEALTH.key(stack.cell.cell, service="robot-server-fr"))
        sample = health.recv()
        return unpack(Health, message_in(sample.payload.to_bytes())).detail
    finally:
        session.close()


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
