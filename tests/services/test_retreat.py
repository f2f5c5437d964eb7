"""Retreat: what is let go while bodies are nearer than the stop distance, and what is not."""

import numpy as np
import pytest
from gate_bench import (
    CELL,
    FR_BESIDE_GR,
    GR_ABOVE_FR,
    GR_BESIDE_FR,
    HOME,
    LIMITS,
    ORACLE,
    PROXIMITY,
    STOP_M,
    above_the_floor,
    at_rest,
    in_motion,
    one_joint,
    with_room,
)
from small_cell import admission_after

from deltaq_protocol.guarded import KeptDistance
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.retreat import ALLOWANCE_M, Retreat, Violations

GATE = CELL.description.gate
SLOW = GATE.retreat_speed * LIMITS["fr"].max_dq
OUT = one_joint("fr", 1, -SLOW[1])
FLOOR = "fr/link_3 structure/floor"
BESIDE_THE_TIE = np.array((-1.931, 0.393, -0.18636, 1.8635, 0.65283, -1.6266))
"""Where the camera and a little of link 5 are too near to the structure's eastern tie."""


def find(robot, request, others=(), at_most=1.0, violations=None):
    retreat = Retreat(PROXIMITY, GATE, Violations() if violations is None else violations)
    return retreat.find(robot, others, LIMITS[robot.name], robot.brake(), request, at_most)


def violations_of(*robots):
    """What pairs have to keep once each of these robots, all at rest, has been looked at."""
    violations = Violations()
    for robot in robots:
        find(
            robot,
            np.zeros_like(robot.q_cmd),
            [other for other in robots if other is not robot],
            1.0,
            violations,
        )
    return violations


def told(reasons):
    return [reason.what for reason in reasons]


@pytest.fixture(scope="module")
def low():
    """FR, 2 mm too near to the floor."""
    return at_rest("fr", above_the_floor(-2e-3))


def test_every_too_near_pair_is_named_with_its_distance_and_bound(low):
    _, (reason,) = find(low, OUT)
    assert (reason.code, reason.what, reason.bound) == (ReasonCode.RETREAT, FLOOR, STOP_M)
    assert reason.value == pytest.approx(STOP_M - 2e-3, abs=1e-5)


def test_outward_motion_is_admitted_up_to_the_retreat_speed(low):
    assert find(low, OUT)[0] == 1.0
    assert find(low, 0.5 * OUT)[0] == 1.0
    assert find(low, 4 * OUT)[0] == pytest.approx(0.25)


def test_a_retreat_keeps_the_joint_limits(low):
    assert find(low, 2 * OUT, at_most=0.2)[0] == 0.2
    assert find(low, OUT, at_most=0.0)[0] == 0.0


def test_inward_motion_is_held_and_motion_at_constant_distance_admitted(low):
    assert find(low, -OUT)[0] == 0.0
    least = -0.02 * OUT
    assert LIMITS["fr"].brake_cycles(least) == 1  # it is at rest after the first setpoint
    assert find(low, least)[0] == 0.0
    assert find(low, one_joint("fr", 0, SLOW[0]))[0] == 1.0  # about the vertical


def test_a_robot_moving_in_a_violation_must_first_come_to_rest():
    assert find(in_motion("fr", above_the_floor(-2e-3), OUT), OUT) == (0.0, [])


def test_a_begun_retreat_continues_without_a_stop():
    known = violations_of(at_rest("fr", above_the_floor(-2.5e-3)))
    moving = in_motion("fr", above_the_floor(-1e-3), 0.05 * OUT)
    assert find(moving, OUT, violations=known)[0] == 1.0
    assert find(moving, -0.1 * OUT, violations=known)[0] == 1.0  # not nearer than it began
    assert find(moving, -OUT, violations=known)[0] == 0.0
    nearer_before = in_motion("fr", above_the_floor(-1e-3), 0.5 * OUT)
    assert find(nearer_before, OUT, violations=known)[0] == 0.0  # its drives may still be there


def test_an_admission_starts_where_the_brake_continues():
    known = violations_of(at_rest("fr", above_the_floor(-2e-3)))
    inwards = -0.2 * OUT
    moving = in_motion("fr", above_the_floor(-1e-3), inwards)
    assert find(moving, inwards, violations=known)[0] == 1.0
    assert find(moving, inwards + 2 * moving.brake(), violations=known)[0] == 0.0


def test_a_violation_lasts_until_the_drives_have_left_it():
    known = violations_of(at_rest("fr", above_the_floor(-2e-3)))
    leaving = in_motion("fr", above_the_floor(5e-3), 0.5 * OUT)
    assert find(leaving, OUT, violations=known)[0] == 1.0
    assert known.kept_m(frozenset(FLOOR.split())) is not None


def test_a_violation_ends_for_a_moving_robot_when_its_pair_is_shown_to_be_clear():
    known = violations_of(at_rest("fr", above_the_floor(-2e-3)))
    along = in_motion("fr", above_the_floor(3e-3), one_joint("fr", 0, LIMITS["fr"].max_dq[0] / 2))
    find(along, OUT, violations=known)
    assert known.snapshot() == ()


def test_of_two_too_near_pairs_the_measured_one_is_reported_in_motion():
    both = told(find(at_rest("fr", BESIDE_THE_TIE), OUT)[1])
    assert sorted(both) == ["fr/link_5 structure/tie_east", "fr/tool_camera structure/tie_east"]
    moving = in_motion("fr", BESIDE_THE_TIE, one_joint("fr", 5, 1e-6))
    for measured in both:
        known = Violations()
        known.stands(frozenset(measured.split()), 0.0, STOP_M)
        assert told(find(moving, OUT, violations=known)[1]) == [measured]


def test_a_brake_faster_than_retreat_has_to_end_first():
    known = Violations()
    known.stands(frozenset(FLOOR.split()), 0.0, STOP_M)
    fast = in_motion("fr", above_the_floor(-2e-3), 2 * OUT)
    assert np.max(np.abs(fast.brake()) / SLOW) > 1
    assert find(fast, OUT, violations=known)[0] == 0.0
    slow = in_motion("fr", above_the_floor(-2e-3), 1.05 * OUT)
    assert find(slow, OUT, violations=known)[0] > 0.0


def test_a_return_is_admitted_up_to_the_distance_at_the_begin_of_the_violation():
    known = violations_of(at_rest("fr", above_the_floor(-2e-3)))
    back = at_rest("fr", above_the_floor(-1e-3))
    assert find(back, -0.2 * OUT, violations=known)[0] == 1.0
    assert find(back, -OUT, violations=known)[0] == 0.0


@pytest.mark.parametrize("below_m", [0.5e-3, 5e-3])
def test_many_admissions_never_creep_nearer(below_m):
    q, known = above_the_floor(-below_m), Violations()
    began = ORACLE.between_robots_and_structure(HOME | {"fr": q}).distance_m
    for inwards in (0.4e-6, 3e-6, 30e-6) * 40:
        scale, _ = find(at_rest("fr", q), one_joint("fr", 1, inwards), violations=known)
        q = q + scale * one_joint("fr", 1, inwards)
    assert ORACLE.between_robots_and_structure(HOME | {"fr": q}).distance_m > began - 1e-5


def test_drives_off_their_setpoint_do_not_prolong_a_violation():
    q, known = above_the_floor(-2e-3), Violations()
    for sag in (1e-4, 3e-4, 2e-4, 4e-4):
        robot = at_rest("fr", q, measured=q + one_joint("fr", 1, sag))
        assert find(robot, OUT, violations=known)[0] == 1.0
        assert find(robot, -0.02 * OUT, violations=known)[0] == 0.0


def test_a_pair_at_the_stop_distance_is_certified_as_usual():
    clear = at_rest("fr", above_the_floor(1.5e-3))
    assert find(clear, OUT) == (1.0, [])
    assert find(clear, -0.1 * OUT) == (1.0, [])
    assert find(clear, -OUT) == (0.0, [])


def test_a_pair_at_the_stop_distance_within_the_accuracy_of_coal_may_retreat():
    assert find(at_rest("fr", above_the_floor(0.0)), OUT)[0] == 1.0
    assert find(at_rest("fr", above_the_floor(0.0)), -0.02 * OUT)[0] == 0.0


def test_motion_along_a_body_is_no_violation():
    robot = in_motion("fr", above_the_floor(3e-3), one_joint("fr", 0, LIMITS["fr"].max_dq[0] / 2))
    assert find(robot, OUT)[1] == []


def test_either_robot_may_end_a_common_violation():
    here = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}
    gr, fr = at_rest("gr", with_room(-2e-3, "gr", here, 4)), at_rest("fr", FR_BESIDE_GR)
    slow = GATE.retreat_speed * LIMITS["gr"].max_dq[4]
    outwards, inwards = one_joint("gr", 4, -slow), one_joint("gr", 4, slow)
    scale, reasons = find(gr, outwards, [fr])
    assert (scale, told(reasons)) == (1.0, ["gr/link_3 fr/link_1"])
    assert find(gr, inwards, [fr])[0] == 0.0
    turns = [find(fr, sign * one_joint("fr", 0, SLOW[0]), [gr]) for sign in (1, -1)]
    assert sorted(scale for scale, _ in turns) == [0.0, 1.0]
    assert told(turns[0][1]) == ["fr/link_1 gr/link_3"]


def in_flight(gr, increment):
    """GR, with an admission on its way that turns its joint 4."""
    gr.admitted(admission_after(gr.state, one_joint("gr", 4, increment), 4, cycle=1))
    return gr


@pytest.mark.parametrize("deep_m", [1e-3, 2e-2])
def test_a_robot_inside_a_body_may_only_leave_it(deep_m):
    within = at_rest("fr", above_the_floor(-STOP_M - deep_m))
    scale, (reason,) = find(within, OUT)
    assert (scale, reason.what, reason.value) == (1.0, FLOOR, pytest.approx(-deep_m, abs=1e-5))
    assert find(within, -0.02 * OUT)[0] == 0.0


def test_of_two_overlapping_robots_either_may_only_leave():
    here = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}
    gr, fr = at_rest("gr", with_room(-STOP_M - 5e-3, "gr", here, 4)), at_rest("fr", FR_BESIDE_GR)
    slow = GATE.retreat_speed * LIMITS["gr"].max_dq[4]
    scale, reasons = find(gr, one_joint("gr", 4, -slow), [fr])
    assert scale == 1.0
    assert min(reason.value for reason in reasons) == pytest.approx(-5e-3, abs=1e-5)
    assert find(gr, one_joint("gr", 4, 0.1 * slow), [fr])[0] == 0.0
    assert turns_of(fr, gr) == [0.0, 1.0]


def turns_of(fr, gr, violations=None):
    return sorted(find(fr, sign * one_joint("fr", 0, SLOW[0]), [gr], 1.0, violations)[0] for sign in (1, -1))


def test_a_retreat_from_a_moving_robot_waits_until_it_stands():
    here = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}
    gr, fr = at_rest("gr", with_room(-2e-3, "gr", here, 4)), at_rest("fr", FR_BESIDE_GR)
    assert turns_of(fr, gr) == [0.0, 1.0]
    assert turns_of(fr, in_flight(gr, -2e-3)) == [0.0, 0.0]  # though it leads away


def test_a_retreat_keeps_clear_of_the_tube_of_another_retreating_robot():
    here = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}
    gr, fr = at_rest("gr", with_room(-2e-3, "gr", here, 4)), at_rest("fr", FR_BESIDE_GR)
    known = violations_of(gr, fr)
    assert turns_of(fr, in_flight(gr, -2e-3), known) == [0.0, 1.0]
    assert turns_of(fr, in_flight(gr, 2e-3), known) == [0.0, 0.0]  # it comes nearer than it began, by then


def test_retreat_from_one_body_does_not_lead_too_near_to_another(low):
    gr = at_rest("gr", GR_ABOVE_FR)
    room_m = ORACLE.between_robots({"fr": low.q_cmd, "gr": GR_ABOVE_FR}).distance_m - STOP_M
    assert 1.1e-3 < room_m < 2e-3
    scale, reasons = find(low, OUT, [gr])
    assert (scale, told(reasons)) == (0.0, [FLOOR])
    assert find(low, 0.2 * OUT, [gr])[0] == 1.0


def test_a_search_for_a_retreat_does_not_change_later_measurements(low):
    groups = PROXIMITY.alone["fr"]

    def measured():
        PROXIMITY.place("fr", HOME["fr"], np.zeros(6))
        return [PROXIMITY.least(group) for group in groups]

    before = measured()
    find(low, OUT)
    find(low, -OUT)
    assert measured() == before


# What violated pairs have to keep: measured once, and kept until the violation has ended.

PAIR = frozenset({"fr/link_3", "structure/floor"})
ROBOTS = frozenset({"fr/link_1", "gr/link_3"})


@pytest.fixture
def violations():
    return Violations()


def test_a_pair_keeps_its_distance_at_the_begin_of_its_violation(violations):
    assert violations.kept_m(PAIR) is None
    violations.stands(PAIR, 0.048, STOP_M)
    assert violations.kept_m(PAIR) == pytest.approx(0.048 - ALLOWANCE_M, abs=1e-15)
    violations.stands(PAIR, 0.049, STOP_M)
    assert violations.kept_m(PAIR) == pytest.approx(0.048 - ALLOWANCE_M, abs=1e-15)


def test_a_repeatedly_measured_pair_does_not_creep(violations):
    violations.stands(PAIR, 0.048, STOP_M)
    for _ in range(1000):
        kept = violations.kept_m(PAIR)
        violations.stands(PAIR, kept - 1.9e-6, STOP_M)  # as much as a second measurement may be off
        assert violations.kept_m(PAIR) == kept


def test_a_pair_brought_nearer_by_another_cause_keeps_its_present_distance(violations):
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


def test_a_restored_gate_continues_with_the_same_violations(violations):
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
