"""The SIM's core, message by message, with real Robot Servers' cores behind it."""

import numpy as np
import pytest
from gate_rig import CELL, SMALL, Rig

from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import Outcome, Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.core import Sim


@pytest.fixture
def rig():
    return Rig()


def refused(verdict):
    assert verdict.outcome is Outcome.REFUSED
    return verdict.reasons[0].code


def test_an_increment_is_admitted_and_named_by_what_it_follows(rig):
    verdict = rig.request()
    admission = rig.mail["fr"][0]
    assert verdict.outcome is Outcome.ADMITTED
    assert (admission.cycle, admission.follows_sequence) == (rig.state.cycle, rig.state.sequence)
    assert admission.follows_q_cmd == rig.state.q_cmd
    rig.cycle()
    assert rig.state.phase is Phase.ENGAGED
    assert rig.state.sequence == admission.sequence


def test_each_state_is_decided_once_and_the_next_request_waits_for_the_next_state(rig):
    assert rig.request().outcome is Outcome.ADMITTED
    assert rig.request() is None
    rig.cycle()
    assert rig.verdict() is None  # until the HLI has nothing newer
    assert rig.alive().outcome is Outcome.ADMITTED


def test_of_two_that_wait_the_newer_counts_and_the_other_is_told(rig):
    rig.request()
    rig.request(seq=5)
    verdict = rig.request(seq=6)
    assert (refused(verdict), verdict.seq) == (ReasonCode.SUPERSEDED, 5)
    rig.cycle()
    assert rig.alive().seq == 6


def test_a_stale_request_is_refused_with_the_oldest_cycle_allowed(rig):
    for _ in range(20):
        rig.cycle()
    verdict = rig.request(cycle=rig.state.cycle - 11)
    assert refused(verdict) is ReasonCode.STALE_CYCLE
    assert verdict.reasons[0].bound == rig.state.cycle - 10
    assert rig.request(cycle=rig.state.cycle - 10).outcome is Outcome.ADMITTED


def test_a_request_may_overtake_the_state_it_answers_but_not_by_far(rig):
    assert rig.request(cycle=rig.state.cycle + 1) is None
    rig.cycle()
    assert rig.verdict().outcome is Outcome.ADMITTED
    rig.cycle()
    assert refused(rig.request(cycle=rig.state.cycle + 9)) is ReasonCode.FUTURE_CYCLE


def test_a_replayed_sequence_is_refused(rig):
    rig.request(seq=7)
    rig.cycle()
    assert refused(rig.request(seq=7)) is ReasonCode.REPLAYED_SEQUENCE
    assert refused(rig.request(seq=3)) is ReasonCode.REPLAYED_SEQUENCE


def test_an_older_lease_is_refused_and_a_newer_one_begins_to_count_again(rig):
    rig.request(seq=7, lease_epoch=3)
    rig.cycle()
    assert refused(rig.request(seq=8, lease_epoch=2)) is ReasonCode.LEASE_NOT_HELD
    assert rig.request(seq=1, lease_epoch=4).outcome is Outcome.ADMITTED


def test_seven_numbers_are_refused(rig):
    verdict = rig.request(dq=(0.0,) * 7)
    assert refused(verdict) is ReasonCode.BAD_SHAPE
    assert (verdict.reasons[0].value, verdict.reasons[0].bound) == (7, 6)


def test_an_unknown_robot_is_counted_and_disturbs_nothing(rig):
    assert rig.request(robot="nobody") is None
    assert rig.sim.counters["unknown_request"] == 1
    assert rig.request().outcome is Outcome.ADMITTED


def test_a_stop_holds_every_robot_until_each_is_reset(rig):
    assert rig.command(kind="stop") is None  # answered when both have shown it
    assert rig.command(kind="reset", robot="fr").code is ReasonCode.NOT_AT_REST
    rig.cycle()
    rig.cycle()
    assert rig.reply().accepted
    assert rig.state.phase is Phase.HELD
    assert rig.servers["gr"].state.phase is Phase.HELD
    assert refused(rig.request()) is ReasonCode.STOPPED
    rig.command(kind="reset", robot="fr")
    rig.cycle()
    rig.cycle()
    assert rig.reply().accepted
    assert rig.state.phase is Phase.READY
    assert rig.servers["gr"].state.phase is Phase.HELD


def test_a_reset_is_refused_while_the_robot_comes_to_rest(rig):
    for count in range(1, 8):
        rig.request(dq=(count * 1.5e-3, 0, 0, 0, 0, 0))
        rig.cycle()
    rig.command(kind="stop")
    rig.cycle()
    rig.cycle()
    assert rig.state.phase is Phase.HELD
    reply = rig.command(kind="reset", robot="fr")
    assert (reply.accepted, reply.code) == (False, ReasonCode.NOT_AT_REST)


def test_a_robot_off_its_path_is_held_and_not_reset_before_it_is_back(rig):
    rig.cycle(offset=0.1)
    rig.cycle(offset=0.1)
    assert (rig.state.phase, rig.state.reason) == (Phase.HELD, ReasonCode.TRACKING_ERROR)
    for _ in range(10):
        rig.cycle(offset=0.1)
    reply = rig.command(kind="reset", robot="fr")
    assert reply.code is ReasonCode.CAUSE_STANDS
    assert "0.1000" in reply.message
    rig.cycle()
    rig.command(kind="reset", robot="fr")
    rig.cycle()
    rig.cycle()
    assert rig.state.phase is Phase.READY


def test_a_silent_hli_holds_the_robots_it_served(rig):
    rig.alive()
    for _ in range(60):
        rig.cycle()
    assert (rig.state.phase, rig.state.reason) == (Phase.HELD, ReasonCode.HLI_LOST)
    assert rig.servers["gr"].state.phase is Phase.READY


def test_a_silent_krc_is_a_standing_cause(rig):
    rig.servers["fr"].krc_silent(rig.time_s + 1)
    rig.deliver(rig.sim.on_state(rig.state))
    assert rig.command(kind="reset", robot="fr").code is ReasonCode.CAUSE_STANDS


def test_a_lost_admission_stays_part_of_what_the_robot_may_do(rig):
    rig.request(dq=(1e-3, 0, 0, 0, 0, 0))
    tracker = rig.sim.robots["fr"].tracker
    assert len(tracker.tubes()) == 2
    rig.mail["fr"] = (None, rig.mail["fr"][1])
    rig.cycle()
    assert len(tracker.tubes()) == 1
    assert tracker.missed == 1


def test_digital_outputs_reach_the_robot(rig):
    rig.command(kind="io", robot="gr", outputs={"gripper": True})
    rig.cycle()
    rig.cycle()
    assert rig.servers["gr"].outputs["gripper"] is True


def test_a_state_of_the_wrong_length_is_counted_and_ignored(rig):
    state = rig.state.model_copy(update={"q": (0.0,) * 5, "cycle": rig.state.cycle + 1})
    assert rig.sim.on_state(state) == []
    assert rig.sim.counters["unknown_state"] == 1


def test_the_nearest_pair_is_told_with_its_distance(rig):
    near = rig.sim.nearest()
    assert 0.02 < near.distance_m < 0.2
    assert np.linalg.norm(np.subtract(*near.points_m)) == pytest.approx(near.distance_m, abs=1e-6)


def test_retreat_leads_out_of_a_violation_slowly_and_not_further_in():
    too_near = CELL.robots["fr"].home.copy()
    too_near[1] = np.deg2rad(21.6)  # brings link 3 within the stop distance of the floor
    rig = Rig(fr=too_near)
    assert rig.sim.nearest().distance_m < 0.049
    down, up = (0, 1e-4, 0, 0, 0, 0), (0, -0.03, 0, 0, 0, 0)
    further_in = rig.request(dq=down)
    assert (further_in.outcome, further_in.reasons[0].code) == (Outcome.HELD, ReasonCode.RETREAT)
    assert "structure/floor" in further_in.reasons[0].what
    fastest = 0.0
    while rig.sim.nearest().distance_m < 0.05:
        rig.cycle()
        verdict = rig.request(dq=up)
        assert verdict.outcome is Outcome.SCALED
        if verdict.reasons[0].code is ReasonCode.RETREAT:
            fastest = max(fastest, abs(verdict.dq[1]))
    slow = CELL.description.gate.retreat_speed * CELL.robots["fr"].max_velocity[1] * 0.012
    assert 0 < fastest <= slow * (1 + 1e-9)
    for _ in range(30):
        rig.cycle()
        rig.request(dq=up)
    assert abs(rig.verdict().dq[1]) > 2 * slow


def violated_by_both():
    """A rig whose gate has measured one robot too near to the floor, and remembers the same of the other."""
    low = CELL.robots["fr"].home.copy()
    low[1] = np.deg2rad(21.6)
    rig = Rig(fr=low)
    rig.request(dq=(0, 1e-4, 0, 0, 0, 0))
    (fr,) = rig.sim.violations.snapshot()
    gr = fr.model_copy(update={"pair": ("gr/link_3", "structure/floor")})
    rig.sim.violations.restore([fr, gr])
    return rig, fr, gr


def test_a_server_that_starts_anew_begins_without_the_violations_of_its_robot_and_leaves_the_others():
    rig, fr, gr = violated_by_both()
    rig.cycle()
    assert rig.sim.violations.snapshot() == (fr, gr)
    rig.restart_server("fr")
    rig.cycle()
    assert rig.sim.violations.snapshot() == (gr,)


def test_a_robot_that_somebody_else_displaced_begins_without_its_violations_too():
    rig, _, gr = violated_by_both()
    state = rig.state
    elsewhere = tuple((np.array(state.q_cmd) + 0.1).tolist())
    resets = rig.sim.robots["fr"].orders.resets = state.resets + 1  # which took what its KRC had
    fields = {"cycle": state.cycle + 1, "q": elsewhere, "q_cmd": elsewhere, "resets": resets, "sequence": 0}
    rig.sim.on_state(state.model_copy(update=fields))
    assert rig.sim.robots["fr"].tracker.displaced
    assert rig.sim.violations.snapshot() == (gr,)


def test_nothing_is_admitted_beside_a_robot_that_was_never_heard(rig):
    alone = Sim(CELL, epoch=9)
    state = rig.state.model_copy(update={"epoch": 9})
    alone.on_state(state)
    outputs = alone.on_request(Request(robot="fr", cycle=state.cycle, lease_epoch=1, seq=1, dq=SMALL))
    verdict = outputs[-1].message
    assert refused(verdict) is ReasonCode.NOT_READY
    assert verdict.reasons[0].what == "gr"


def test_what_is_asked_of_a_new_server_in_its_first_cycle_is_answered_at_once(rig):
    rig.restart_server("fr")
    rig.cycle()
    assert rig.state.cycle == 1
    assert rig.request().reasons[0].code is ReasonCode.NOT_READY


def test_a_robot_server_that_was_started_anew_is_held_until_a_reset(rig):
    rig.request()
    rig.cycle()
    rig.restart_server("fr")
    for _ in range(80):
        rig.cycle()
    assert (rig.state.phase, rig.state.reason) == (Phase.HELD, ReasonCode.SERVER_LOST)
    assert refused(rig.request()) is ReasonCode.STOPPED
    rig.command(kind="reset", robot="fr")
    for _ in range(8):
        rig.cycle()
    assert rig.state.phase is Phase.READY


def test_a_verdict_tells_how_long_the_brake_behind_it_takes(rig):
    admitted = rig.request()
    assert admitted.time_to_stop_s == pytest.approx(rig.mail["fr"][0].brake_cycles * CELL.description.cycle_s)
    assert admitted.time_to_stop_s > 0.0
