"""A KRC with RSI_ON(#RELATIVE): there a constant correction is a constant speed, until somebody stops it."""

import numpy as np

from deltaq_emulator.settings import KrcSettings
from deltaq_experiments import lockstep
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode

FASTEST = np.full(6, 1e-3)


def test_motion_that_goes_on_after_the_brake_is_held_for_good_and_the_krc_told_to_end_it(monkeypatch):
    relative = KrcSettings.load().model_copy(update={"correction": "relative"})
    monkeypatch.setattr(lockstep.KrcSettings, "load", lambda: relative)
    stack = lockstep.Lockstep("lab")
    stack.run_until_ready()
    stack.acquire("fr", "test")
    arm, dq = stack.arms["fr"], np.zeros(6)
    while arm.server.state.phase is not Phase.HELD:
        stack.cycle()
        dq = np.minimum(dq + FASTEST / 5, FASTEST)
        stack.ask("fr", dq)
    assert arm.server.state.reason is ReasonCode.TRACKING_ERROR
    held = 0
    while not arm.server.motion_stop:
        stack.cycle()
        held += 1
    assert held < 20
    stack.reset("fr")
    for _ in range(20):
        stack.cycle()
        assert arm.server.state.phase is Phase.HELD
        assert arm.server.motion_stop
