"""One decision of the gate at a time: how much of a request is admitted, and what it says of the rest."""

import sys
from contextlib import contextmanager

import numpy as np
import pytest
from gate_bench import (
    CELL,
    FR_BESIDE_GR,
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
from ran import ran
from small_cell import admission_after

from deltaq_cell.description import ContactDescription
from deltaq_protocol.messages import Outcome, Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.certificate import Certifier
from deltaq_services.sim.gate import Contacts, Gate
from deltaq_services.sim.retreat import Violations


def decide(robot, request, others=(), violations=None):
    violations = Violations() if violations is None else violations
    gate = Gate(PROXIMITY, LIMITS, CELL.description.gate, Contacts(PROXIMITY, {}), violations)
    return gate.decide(robot, list(others), request)


def test_an_unlimited_request_is_admitted_unchanged():
    request = 0.5 * LIMITS["fr"].max_dv
    decision = decide(at_rest("fr", HOME["fr"]), request, [at_rest("gr", HOME["gr"])])
    assert (decision.outcome, decision.scale, decision.brake_cycles) == (Outcome.ADMITTED, 1.0, 1)
    assert decision.reasons == ()
    np.testing.assert_array_equal(decision.dq, request)
    assert decision.binding.room_m > 0


def test_a_scaled_increment_lies_between_brake_and_request_with_its_own_brake():
    dq = 3 * one_joint("fr", 0, LIMITS["fr"].max_dv[0])
    robot = in_motion("fr", HOME["fr"], dq)
    decision = decide(robot, 3 * dq)
    np.testing.assert_allclose(decision.dq, 4 / 3 * dq)  # one step of acceleration more
    brake = robot.brake()
    np.testing.assert_allclose(decision.dq, brake + decision.scale * (3 * dq - brake))
    assert decision.outcome is Outcome.SCALED
    assert decision.brake_cycles == 4
    assert [reason.code for reason in decision.reasons] == [ReasonCode.ACCELERATION_LIMIT]


def test_the_tighter_of_two_limits_is_reported():
    q = HOME["fr"] + one_joint("fr", 5, LIMITS["fr"].upper[5] - HOME["fr"][5] - 1e-3)
    decision = decide(at_rest("fr", q), one_joint("fr", 5, 2 * LIMITS["fr"].max_dv[5]))
    assert decision.outcome is Outcome.SCALED
    assert [reason.code for reason in decision.reasons] == [ReasonCode.POSITION_LIMIT]


def test_a_request_scaled_to_almost_nothing_is_held_and_the_brake_continues():
    q = HOME["fr"] + one_joint("fr", 5, LIMITS["fr"].upper[5] - HOME["fr"][5] - 1e-6)
    decision = decide(at_rest("fr", q), one_joint("fr", 5, LIMITS["fr"].max_dv[5]))
    assert (decision.outcome, decision.scale, decision.brake_cycles) == (Outcome.HELD, 0.0, 1)
    np.testing.assert_array_equal(decision.dq, np.zeros(6))
    assert decision.reasons[0].code is ReasonCode.POSITION_LIMIT


def test_a_request_held_in_motion_reports_the_remaining_brake():
    step = LIMITS["fr"].max_dv[5]
    dq = one_joint("fr", 5, 4 * step)
    # its brake ends on the limit
    robot = in_motion(
        "fr", HOME["fr"] + one_joint("fr", 5, LIMITS["fr"].upper[5] - HOME["fr"][5] - 6 * step), dq
    )
    decision = decide(robot, 2 * dq)
    assert decision.outcome is Outcome.HELD
    np.testing.assert_allclose(decision.dq, 0.75 * dq)
    assert decision.brake_cycles == 3


def test_near_a_body_the_admitted_motion_uses_the_space_above_the_stop_distance():
    room_m, request = 2e-4, one_joint("fr", 1, LIMITS["fr"].max_dv[1])
    q = above_the_floor(room_m)
    decision = decide(at_rest("fr", q), request, [at_rest("gr", HOME["gr"])])
    assert decision.outcome is Outcome.SCALED
    np.testing.assert_array_equal(decision.dq, decision.scale * request)
    assert decision.brake_cycles == 1
    (reason,) = decision.reasons
    assert (reason.code, reason.what) == (ReasonCode.CLEARANCE, "fr/link_3 structure/floor")
    assert reason.value < reason.bound == STOP_M
    assert decision.binding.nearest.pair == ("fr/link_3", "structure/floor")

    def distance_m(scale):
        return ORACLE.between_robots_and_structure(HOME | {"fr": q + scale * request}).distance_m

    assert distance_m(decision.scale) >= STOP_M
    assert distance_m(decision.scale + 0.1) < STOP_M  # and the gate is not timid


def test_at_the_stop_distance_a_request_that_leads_nearer_is_held_for_clearance():
    q = above_the_floor(2e-5)
    decision = decide(at_rest("fr", q), one_joint("fr", 1, LIMITS["fr"].max_dv[1]))
    assert decision.outcome is Outcome.HELD
    assert [reason.code for reason in decision.reasons] == [ReasonCode.CLEARANCE]
    assert decision.binding.nearest.pair == ("fr/link_3", "structure/floor")


def test_within_the_stop_distance_slow_outward_motion_is_admitted_as_retreat():
    robot, violations = at_rest("fr", above_the_floor(-40e-3)), Violations()
    out = decide(robot, one_joint("fr", 1, -LIMITS["fr"].max_dv[1]), violations=violations)
    assert out.outcome is Outcome.ADMITTED
    slow = CELL.description.gate.retreat_speed * LIMITS["fr"].max_dq[1]
    moving = in_motion("fr", above_the_floor(-2e-3), one_joint("fr", 1, -0.9 * slow))
    unknown = decide(moving, one_joint("fr", 1, -0.9 * slow))  # nobody measured what it had when it began
    assert unknown.outcome is Outcome.HELD
    decision = decide(moving, one_joint("fr", 1, -1.1 * slow), violations=violations)
    assert decision.outcome is Outcome.SCALED
    assert decision.dq[1] == pytest.approx(-slow)
    assert [reason.code for reason in decision.reasons] == [ReasonCode.RETREAT]
    further_in = decide(robot, one_joint("fr", 1, 1e-4), violations=violations)
    assert further_in.outcome is Outcome.HELD
    assert [reason.code for reason in further_in.reasons] == [ReasonCode.RETREAT]


def codes(decision):
    return [reason.code for reason in decision.reasons]


def test_a_retreat_blocked_by_a_joint_limit_names_the_limit_first():
    at_limit = one_joint("fr", 5, LIMITS["fr"].upper[5] - HOME["fr"][5])
    robot, violations = at_rest("fr", above_the_floor(-2e-3) + at_limit), Violations()
    outwards, beyond = one_joint("fr", 1, -1e-4), one_joint("fr", 5, 1e-4)
    barred = decide(robot, outwards + beyond, violations=violations)
    assert (barred.outcome, codes(barred)) == (Outcome.HELD, [ReasonCode.POSITION_LIMIT, ReasonCode.RETREAT])
    assert (barred.reasons[0].what, barred.reasons[0].bound) == ("a6", LIMITS["fr"].upper[5])
    assert decide(robot, outwards - beyond, violations=violations).outcome is Outcome.ADMITTED


def test_a_retreat_names_its_limiting_factor():
    robot, violations = at_rest("fr", above_the_floor(-2e-3)), Violations()
    outwards = one_joint("fr", 1, -1.5 * LIMITS["fr"].max_dv[1])
    by_limit = decide(robot, outwards, violations=violations)
    assert codes(by_limit) == [ReasonCode.ACCELERATION_LIMIT, ReasonCode.RETREAT]
    assert by_limit.scale == pytest.approx(1 / 1.5)
    assert codes(decide(robot, -outwards, violations=violations)) == [ReasonCode.RETREAT]


def test_a_robot_moving_in_an_unmeasured_violation_gets_the_missing_clearance():
    moving = in_motion("fr", above_the_floor(-2e-3), one_joint("fr", 1, -1e-3))
    (reason,) = decide(moving, one_joint("fr", 1, -1e-3)).reasons
    assert (reason.code, reason.what) == (ReasonCode.CLEARANCE, "fr/link_3 structure/floor")


def test_a_violation_ends_with_an_ordinarily_certified_motion():
    violations = violated_once()
    decision = decide(at_rest("fr", above_the_floor(1e-3)), one_joint("fr", 1, -1e-4), violations=violations)
    assert decision.outcome is Outcome.ADMITTED
    assert violations.snapshot() == ()


def test_a_violation_ends_with_a_certified_rest_position():
    violations = violated_once()
    inwards = one_joint("fr", 1, LIMITS["fr"].max_dv[1])
    decision = decide(at_rest("fr", above_the_floor(2e-4)), inwards, violations=violations)
    assert (decision.outcome, codes(decision)) == (Outcome.SCALED, [ReasonCode.CLEARANCE])
    assert violations.snapshot() == ()


def violated_once():
    """What a pair has to keep after a decision on a robot that stood too near to the floor."""
    violations = Violations()
    decide(at_rest("fr", above_the_floor(-2e-3)), one_joint("fr", 1, -1e-4), violations=violations)
    assert len(violations.snapshot()) == 1
    return violations


def test_the_gate_keeps_clear_of_the_other_robot():
    gr = with_room(1e-3, "gr", {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}, 4)
    toward = in_motion("gr", gr, one_joint("gr", 4, 5e-4))
    request = one_joint("gr", 4, 1.1e-3)
    assert decide(toward, request).outcome is Outcome.ADMITTED
    decision = decide(toward, request, [at_rest("fr", FR_BESIDE_GR)])
    assert decision.outcome is not Outcome.ADMITTED
    assert decision.reasons[0].code is ReasonCode.CLEARANCE
    assert {part.split("/")[0] for part in decision.reasons[0].what.split()} == {"fr", "gr"}


def test_the_gate_keeps_clear_of_the_newest_admission_of_the_other_robot():
    gr = at_rest("gr", with_room(2e-3, "gr", {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}, 4))
    robot = at_rest("fr", FR_BESIDE_GR)
    turns = [one_joint("fr", 0, 1e-4), one_joint("fr", 0, -1e-4)]
    assert [decide(robot, turn, [gr]).outcome for turn in turns] == [Outcome.ADMITTED] * 2
    gr.admitted(admission_after(gr.state, one_joint("gr", 4, 0.01), 5))
    assert Outcome.HELD in [decide(robot, turn, [gr]).outcome for turn in turns]  # the one that leads nearer


def test_a_scaled_increment_is_certified_and_a_larger_one_hardly():
    dq = one_joint("fr", 1, 3 * LIMITS["fr"].max_dv[1])
    robot, request = in_motion("fr", above_the_floor(2.2e-3), dq), 4 / 3 * dq
    decision = decide(robot, request)
    assert decision.outcome is Outcome.SCALED
    assert [reason.code for reason in decision.reasons] == [ReasonCode.CLEARANCE]
    brake = robot.brake()

    def certified(scale):
        dq = brake + scale * (request - brake)
        tube = robot.tube(robot.course(dq, LIMITS["fr"].brake_cycles(dq)))
        return Certifier(PROXIMITY).certify("fr", tube, []).holds

    assert certified(decision.scale)
    assert not certified(decision.scale + 2.1 / 32)


def test_at_the_stop_distance_motion_without_approach_is_admitted():
    robot = at_rest("fr", above_the_floor(2e-5))
    request = one_joint("fr", 0, LIMITS["fr"].max_dv[0])  # about the vertical
    assert decide(robot, request).outcome is Outcome.ADMITTED


def test_outward_motion_is_admitted_despite_the_uncertainty_of_the_lag():
    dq = np.array((-0.00074, 0.00053, 0.00277, -0.0032, 0.0087, 0.01715))
    robot = in_motion("fr", above_the_floor(2.5e-5), dq)
    decision = decide(robot, np.array((-0.0028, -0.0016, 0.0019, 0.0254, -0.00018, 0.0403)))
    assert decision.outcome is Outcome.SCALED
    assert [reason.code for reason in decision.reasons] == [ReasonCode.ACCELERATION_LIMIT]


@contextmanager
def touching(speed):
    """A gate while FR's camera may touch the floor."""
    contact = ContactDescription(bodies=("fr/tool_camera",), against=("structure/floor",), speed=speed)
    contacts = Contacts(PROXIMITY, {"touch": contact})
    contacts.allow(["touch"])
    try:
        yield Gate(PROXIMITY, LIMITS, CELL.description.gate, contacts, Violations())
    finally:
        contacts.allow([])


def test_an_allowed_contact_limits_the_speed_of_its_robot_with_a_reason():
    request = one_joint("fr", 0, LIMITS["fr"].max_dv[0])
    speed = 0.25 * request[0] / LIMITS["fr"].max_dq[0]
    with touching(speed) as gate:
        decision = gate.decide(at_rest("fr", HOME["fr"]), [], request)
        assert decision.scale == pytest.approx(0.25)
        assert decision.reasons == (Reason(code=ReasonCode.CONTACT, what="touch", bound=speed),)
        slower = gate.decide(at_rest("fr", HOME["fr"]), [], 0.2 * request)
        assert slower.outcome is Outcome.ADMITTED


def test_a_motion_held_by_a_limit_is_not_held_for_a_contact():
    step = LIMITS["fr"].max_dv[5]
    dq = one_joint("fr", 5, 4 * step)
    on_the_limit = HOME["fr"] + one_joint("fr", 5, LIMITS["fr"].upper[5] - HOME["fr"][5] - 6 * step)
    with touching(0.01) as gate:
        decision = gate.decide(in_motion("fr", on_the_limit, dq), [], 2 * dq)
        assert decision.outcome is Outcome.HELD
        assert [reason.code for reason in decision.reasons] == [ReasonCode.POSITION_LIMIT]


def test_only_robots_within_reach_are_compared(monkeypatch):
    gate = Gate(PROXIMITY, LIMITS, CELL.description.gate, Contacts(PROXIMITY, {}), Violations())
    fr, gr = at_rest("fr", HOME["fr"]), at_rest("gr", HOME["gr"])
    asked = []
    monkeypatch.setattr(gr, "tubes", lambda: asked.append(gr.name) or [gr.standing()])
    gate.decide(fr, [gr], np.zeros(6))
    assert asked == ["gr"]
    gate._apart_at_zero = {frozenset(("fr", "gr"))}
    gate.decide(fr, [gr], np.zeros(6))  # its rails bring it near
    assert asked == ["gr", "gr"]
    gate._least_apart_m = -20.0
    assert gate.decide(fr, [gr], np.zeros(6)).outcome is Outcome.ADMITTED
    assert asked == ["gr", "gr"]


def test_the_reach_of_a_joint_ends_at_its_limit_or_at_its_position_beyond():
    limits = np.maximum(
        np.abs(CELL.description.robots["fr"].lower), np.abs(CELL.description.robots["fr"].upper)
    )
    inside, outside = HOME["fr"].copy(), HOME["fr"].copy()
    np.testing.assert_allclose(at_rest("fr", inside).farthest(), limits, atol=1e-8)
    outside[1] = -limits[1] - 0.1
    for there in (at_rest("fr", outside), at_rest("fr", inside, measured=outside)):
        assert there.farthest()[1] == pytest.approx(limits[1] + 0.1, abs=1e-8)


# What `python -m deltaq_cell` compiles is all that the gate needs: no decision waits for the compiler.

DECIDE = """
from deltaq_cell.__main__ import main
from deltaq_cell.compiled import told_of_compiling
main()
from deltaq_cell.cell_model import CellModel
from deltaq_experiments.bench.decisions import stored
from deltaq_protocol import topics
from deltaq_services.sim.core import Sim
outcomes = set()
with told_of_compiling(lambda name: print("compiled late:", name)):
    sim = Sim(CellModel.load("lab"), epoch=0)
    for situation in stored():
        sim.restore(situation.memory)
        for output in sim.take(situation.request):
            if output.topic is topics.GATE_VERDICT:
                outcomes.add(output.message.outcome.value)
print(*sorted(outcomes))
"""


@pytest.mark.long
def test_a_gate_that_was_prepared_compiles_nothing_for_its_decisions() -> None:
    decided = ran([sys.executable, "-c", DECIDE])
    assert {"held", "scaled"} <= set(decided.stdout.splitlines()[-1].split())
    assert "compiled late" not in decided.stdout
