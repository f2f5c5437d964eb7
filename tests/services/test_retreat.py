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

from deltaq_protocol.guarded import Admission
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.retreat import Retreat

GATE = CELL.description.gate
SLOW = GATE.retreat_speed * LIMITS["fr"].max_dq
OUT = one_joint("fr", 1, -SLOW[1])
FLOOR = "fr/link_3 structure/floor"


def find(robot, request, others=(), at_most=1.0):
    tubes = [(other.name, tube) for other in others for tube in other.tubes()]
    return Retreat(PROXIMITY, GATE).find(robot, tubes, LIMITS[robot.name], robot.brake(), request, at_most)


def told(reasons):
    return [reason.what for reason in reasons]


@pytest.fixture(scope="module")
def low():
    """FR, 2 mm too near to the floor."""
    return at_rest("fr", above_the_floor(-2e-3))


def test_every_pair_that_is_too_near_is_named_with_its_distance_and_what_it_should_be(low):
    _, (reason,) = find(low, OUT)
    assert (reason.code, reason.what, reason.bound) == (ReasonCode.RETREAT, FLOOR, STOP_M)
    assert reason.value == pytest.approx(STOP_M - 2e-3, abs=1e-5)


def test_motion_outwards_is_let_go_up_to_the_speed_of_retreat(low):
    assert find(low, OUT)[0] == 1.0
    assert find(low, 0.5 * OUT)[0] == 1.0
    assert find(low, 4 * OUT)[0] == pytest.approx(0.25)


def test_no_more_is_let_go_than_the_limits_leave(low):
    assert find(low, 2 * OUT, at_most=0.2)[0] == 0.2
    assert find(low, OUT, at_most=0.0)[0] == 0.0


def test_motion_inwards_is_not_let_go_and_what_changes_no_distance_is(low):
    assert find(low, -OUT)[0] == 0.0
    least = -0.02 * OUT
    assert LIMITS["fr"].brake_cycles(least) == 1  # it is at rest after the first setpoint
    assert find(low, least)[0] == 0.0
    assert find(low, one_joint("fr", 0, SLOW[0]))[0] == 1.0  # about the vertical


def test_a_blend_that_still_leads_inwards_is_not_let_go():
    inwards = in_motion("fr", above_the_floor(-2e-3), -0.5 * OUT)
    assert find(inwards, OUT, at_most=0.1)[0] == 0.0
    assert find(inwards, OUT, at_most=0.4)[0] == 0.4  # the brake that is left is a third of OUT


def test_a_brake_faster_than_retreat_has_to_end_first():
    fast = in_motion("fr", above_the_floor(-2e-3), 2 * OUT)
    assert np.max(np.abs(fast.brake()) / SLOW) > 1
    assert find(fast, OUT) == (0.0, find(fast, OUT)[1])
    slow = in_motion("fr", above_the_floor(-2e-3), 1.05 * OUT)
    assert find(slow, OUT)[0] > 0.0


def test_a_pair_that_keeps_the_stop_distance_is_no_violation_and_is_certified_as_always():
    clear = at_rest("fr", above_the_floor(1.5e-3))
    assert find(clear, OUT) == (1.0, [])
    assert find(clear, -0.1 * OUT) == (1.0, [])
    assert find(clear, -OUT) == (0.0, [])


def test_a_pair_at_the_stop_distance_to_within_what_coal_can_tell_is_led_out():
    assert find(at_rest("fr", above_the_floor(0.0)), OUT)[0] == 1.0


def test_motion_along_a_body_is_no_violation():
    robot = in_motion("fr", above_the_floor(3e-3), one_joint("fr", 0, LIMITS["fr"].max_dq[0] / 2))
    assert find(robot, OUT)[1] == []


def test_a_violation_of_two_robots_is_led_out_of_by_either():
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


def test_each_course_of_another_robot_is_judged_by_itself():
    here = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}
    gr, fr = at_rest("gr", with_room(-2e-3, "gr", here, 4)), at_rest("fr", FR_BESIDE_GR)
    gr.in_flight = Admission(
        robot="gr",
        epoch=1,
        sequence=2,
        cycle=1,
        follows_sequence=1,
        follows_q_cmd=gr.state.q_cmd,
        follows_dq=gr.state.dq,
        dq=tuple(one_joint("gr", 4, 2e-3).tolist()),
        brake_cycles=4,
    )
    turns = [find(fr, sign * one_joint("fr", 0, SLOW[0]), [gr]) for sign in (1, -1)]
    assert sorted(scale for scale, _ in turns) == [0.0, 1.0]
    standing, coming_nearer = turns[0][1]
    assert standing.value == pytest.approx(STOP_M - 2e-3, abs=1e-5)
    assert coming_nearer.value < standing.value - 1e-3


def test_retreat_from_one_body_does_not_lead_too_near_to_another(low):
    gr = at_rest("gr", GR_ABOVE_FR)
    room_m = ORACLE.between_robots({"fr": low.q_cmd, "gr": GR_ABOVE_FR}).distance_m - STOP_M
    assert 1.1e-3 < room_m < 2e-3
    scale, reasons = find(low, OUT, [gr])
    assert (scale, told(reasons)) == (0.0, [FLOOR])
    assert find(low, 0.2 * OUT, [gr])[0] == 1.0


def test_a_look_for_a_way_out_changes_nothing_of_what_is_measured_next(low):
    groups = PROXIMITY.alone["fr"]

    def measured():
        PROXIMITY.place("fr", HOME["fr"], np.zeros(6))
        return [PROXIMITY.least(group) for group in groups]

    before = measured()
    find(low, OUT)
    find(low, -OUT)
    assert measured() == before
