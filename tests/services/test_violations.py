"""What violated pairs have to keep: measured once, and kept until the violation has ended."""

import pytest

from deltaq_protocol.guarded import KeptDistance
from deltaq_services.sim.retreat import ALLOWANCE_M, Violations

STOP_M = 0.05
PAIR = frozenset({"fr/link_3", "structure/floor"})
ROBOTS = frozenset({"fr/link_1", "gr/link_3"})


@pytest.fixture
def violations():
    return Violations()


def test_a_pair_keeps_what_it_had_when_its_violation_began(violations):
    assert violations.kept_m(PAIR) is None
    violations.stands(PAIR, 0.048, STOP_M)
    assert violations.kept_m(PAIR) == pytest.approx(0.048 - ALLOWANCE_M, abs=1e-15)
    violations.stands(PAIR, 0.049, STOP_M)
    assert violations.kept_m(PAIR) == pytest.approx(0.048 - ALLOWANCE_M, abs=1e-15)


def test_a_pair_that_is_measured_again_and_again_does_not_creep(violations):
    violations.stands(PAIR, 0.048, STOP_M)
    for _ in range(1000):
        kept = violations.kept_m(PAIR)
        violations.stands(PAIR, kept - 1.9e-6, STOP_M)  # as much as a second measurement may be off
        assert violations.kept_m(PAIR) == kept


def test_a_pair_that_somebody_else_brought_nearer_keeps_what_it_has_now(violations):
    violations.stands(PAIR, 0.048, STOP_M)
    violations.stands(PAIR, 0.03, STOP_M)
    assert violations.kept_m(PAIR) == pytest.approx(0.03 - ALLOWANCE_M, abs=1e-15)


def test_a_pair_whose_drives_alone_are_too_near_keeps_the_stop_distance(violations):
    violations.stands(PAIR, 0.06, STOP_M)
    assert violations.kept_m(PAIR) == STOP_M


def test_a_violation_ends_for_the_robots_that_it_concerns(violations):
    violations.stands(PAIR, 0.048, STOP_M)
    violations.stands(ROBOTS, 0.047, STOP_M)
    violations.only("gr", {ROBOTS})
    assert violations.kept_m(PAIR) is not None
    assert violations.kept_m(ROBOTS) is not None
    violations.only("gr", ())
    assert violations.kept_m(PAIR) is not None
    assert violations.kept_m(ROBOTS) is None
    violations.only("f", ())  # no robot of that name
    assert violations.kept_m(PAIR) is not None
    violations.only("fr", ())
    assert violations.kept_m(PAIR) is None


def test_another_gate_goes_on_with_the_same_violations(violations):
    violations.stands(ROBOTS, 0.047, STOP_M)
    violations.stands(PAIR, 0.048, STOP_M)
    memory = violations.snapshot()
    assert memory == (
        KeptDistance(pair=("fr/link_1", "gr/link_3"), distance_m=0.047 - ALLOWANCE_M),
        KeptDistance(pair=("fr/link_3", "structure/floor"), distance_m=0.048 - ALLOWANCE_M),
    )
    heir = Violations()
    heir.stands(frozenset({"fr/link_5", "structure/tank_1"}), 0.01, STOP_M)
    heir.restore(memory)
    assert heir.snapshot() == memory
