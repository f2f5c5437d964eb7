"""How much of what is asked for goes through, as an operator sees and feels it."""

from __future__ import annotations

import numpy as np
import pytest
from driving import CYCLE_S, PlainDrive

from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.teleoperator import Reflection, share_of
from deltaq_deploy.command.drive_display import bar
from deltaq_protocol.messages import Outcome, Verdict


def verdict(outcome: Outcome, scale: float) -> Verdict:
    return Verdict(robot="gr", cycle=1, seq=1, outcome=outcome, scale=scale, dq=(0.0,) * 9)


@pytest.mark.long
def test_what_limits_is_reflected_and_speeding_up_is_not() -> None:
    run = PlainDrive("gr", ModeName.JOINT)
    shares = []
    for _ in range(100):
        run.drive(CYCLE_S, e1=0.1)
        shares.append(run.teleoperator.reflection.share)
    assert min(shares) == 1.0
    run.drive(8.0, e1=0.5)
    assert "limit" in run.driven.limitations[-1]
    assert run.teleoperator.reflection.share < 0.01
    run.drive(1.0)
    assert run.teleoperator.reflection.share > 0.99, "nobody asks for anything"


@pytest.mark.long
def test_a_hand_that_is_slowed_down_on_its_line_is_told_by_how_much() -> None:
    run = PlainDrive("fr", ModeName.COUPLED)
    run.drive(0.5, x=-0.1)
    assert run.teleoperator.reflection.share > 0.99
    run.drive(6.0, x=-0.1)
    assert run.driven.limitations[-1]
    assert run.teleoperator.reflection.share < 0.05


@pytest.mark.parametrize(
    ("outcome", "scale", "share"), [(Outcome.SCALED, 0.25, 0.25), (Outcome.HELD, 0.0, 0.0)]
)
def test_what_the_gate_cuts_is_cut_from_what_the_mode_let_through(
    outcome: Outcome, scale: float, share: float
) -> None:
    reflection = Reflection(CYCLE_S)
    reflection.take_verdict(verdict(outcome, scale))
    for _ in range(200):
        reflection.take(1.0, True, False)
    assert reflection.share == pytest.approx(share, abs=1e-3)
    reflection.take_verdict(verdict(Outcome.ADMITTED, 1.0))
    for _ in range(200):
        reflection.take(0.5, True, False)
    assert reflection.share == pytest.approx(1.0, abs=1e-3)


def test_the_share_counts_along_what_is_asked_for_alone() -> None:
    run = PlainDrive("gr", ModeName.JOINT)
    hands = Hands(run.robot)
    asked = Motion.rest(9, 1)
    asked.joints[0] = 0.2
    rates = np.zeros(9)
    rates[:2] = 0.05, 9.0
    assert share_of(asked, rates, hands) == pytest.approx(0.25)
    assert share_of(asked, -rates, hands) == 0.0
    assert share_of(Motion.rest(9, 1), rates, hands) == 1.0
    hand = Motion.rest(9, 1)
    hand.hands[0, 2] = 0.1
    rates = np.linalg.pinv(hands.jacobian) @ np.array([0.5, 0.0, 0.04, 0.0, 0.0, 0.0])
    assert share_of(hand, rates, hands) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("share", "shown"), [(1.0, "[##########]"), (0.42, "[####......]"), (0.0, "[..........]")]
)
def test_a_bar_shows_the_share(share: float, shown: str) -> None:
    assert bar(share) == shown
