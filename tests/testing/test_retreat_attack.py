"""Retreat keeps its word: no pair comes nearer than it was, in situations that a seed draws."""

import pytest

from deltaq_proofs.retreat_attack import TOLERANCE_M, RetreatAttack, summary
from deltaq_services.sim.retreat import Retreat


@pytest.fixture(scope="module")
def attack():
    return RetreatAttack("lab")


@pytest.mark.long
def test_in_a_violation_nothing_comes_nearer(attack):
    figures = summary([attack.run(seed) for seed in range(20)])
    assert figures["nearer_m"]["worst"] <= TOLERANCE_M, figures
    assert figures["moving"] > 5
    assert figures["decisions"]["admitted"] + figures["decisions"]["scaled"] > 50


@pytest.mark.nightly
def test_a_robot_in_a_violation_may_leave_it(attack):
    outwards = [attack.run(seed, ask="outwards") for seed in range(100, 118)]
    figures = summary(outwards)
    assert figures["nearer_m"]["worst"] <= TOLERANCE_M, figures
    assert figures["outwards"]["let_out"] == figures["outwards"]["situations"] >= 4


def test_a_robot_with_overlapping_bodies_may_leave(attack):
    folded = attack.run(301034, ask="outwards")
    assert folded.room_m < -0.022  # link_5 is 2.9 mm inside link_1, and 20 mm are asked for
    assert folded.gained_m > 0.03
    assert folded.nearer_m <= TOLERANCE_M


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("forgotten", ["between setpoints", "since it began"])
def test_a_gate_that_forgets_kept_distances_is_detected(attack, monkeypatch, forgotten):
    if forgotten == "between setpoints":
        monkeypatch.setattr(Retreat, "_keep", lambda *_: True)
    else:
        monkeypatch.setattr("deltaq_services.sim.retreat.ALLOWANCE_M", 1e-3)
    outcomes = [attack.run(seed, ask="inwards") for seed in range(200, 206)]
    assert summary(outcomes)["nearer_m"]["worst"] > 10 * TOLERANCE_M


@pytest.mark.nightly
@pytest.mark.timeout(0)
@pytest.mark.parametrize("first", range(1000, 11_000, 100))
def test_in_ten_thousand_situations_nothing_comes_nearer(attack, first):
    figures = summary([attack.run(seed) for seed in range(first, first + 100)])
    assert figures["nearer_m"]["worst"] <= TOLERANCE_M, figures
