"""The SIM's core, message by message, with real Robot Servers' cores behind it."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gate_rig import CELL, SMALL, Rig, bound
from small_cell import admission_after

import deltaq_cell
import deltaq_protocol.brake
from deltaq_protocol import topics
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.guarded import Command, CommandReply, Health, Request, Supervision
from deltaq_protocol.messages import Outcome, Phase, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.receipts import first_receipt, receipt_of
from deltaq_services.outputs import ToTopic
from deltaq_services.sim.core import Sim
from deltaq_services.sim.fingerprint import code_files
from deltaq_testing.oracle import ClearanceOracle


@pytest.fixture
def rig():
    return Rig()


def refused(verdict):
    assert verdict.outcome is Outcome.REFUSED
    return verdict.reasons[0].code


def test_each_state_is_decided_once_and_the_next_request_waits_for_the_next_state(rig):
    assert rig.request().outcome is Outcome.ADMITTED
    assert rig.request() is None
    rig.cycle()
    assert rig.verdict() is None  # until the HLI has nothing newer
    assert rig.alive().outcome is Outcome.ADMITTED


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


def test_a_silent_krc_is_a_persistent_cause(rig):
    rig.servers["fr"].krc_silent(rig.time_s + 1)
    rig.deliver(rig.sim.on_state(rig.state))
    assert rig.command(kind="reset", robot="fr").code is ReasonCode.CAUSE_STANDS


def test_a_retreat_leaves_a_violation_slowly_and_never_deepens_it():
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


def test_a_restarted_server_drops_the_violations_of_its_robot_only():
    rig, fr, gr = violated_by_both()
    rig.cycle()
    assert rig.sim.violations.snapshot() == (fr, gr)
    rig.restart_server("fr")
    rig.cycle()
    assert rig.sim.violations.snapshot() == (gr,)


def test_a_robot_displaced_by_another_cause_starts_without_violations_too():
    rig, _, gr = violated_by_both()
    state = rig.state
    elsewhere = tuple((np.array(state.q_cmd) + 0.1).tolist())
    resets = rig.sim.robots["fr"].orders.resets = state.resets + 1  # which took what its KRC had
    fields = {"cycle": state.cycle + 1, "q": elsewhere, "q_cmd": elsewhere, "resets": resets, "sequence": 0}
    rig.sim.on_state(state.model_copy(update=fields))
    assert rig.sim.robots["fr"].tracker.displaced
    assert rig.sim.violations.snapshot() == (gr,)


def test_nothing_is_admitted_beside_a_robot_without_a_state(rig):
    alone = Sim(CELL, epoch=9)
    state = rig.state.model_copy(update={"epoch": 9})
    alone.on_state(state)
    outputs = alone.on_request(Request(robot="fr", cycle=state.cycle, lease_epoch=1, seq=1, dq=SMALL))
    verdict = outputs[-1].message
    assert refused(verdict) is ReasonCode.NOT_READY
    assert verdict.reasons[0].what == "gr"


def test_a_request_in_a_new_servers_first_cycle_is_answered_at_once(rig):
    rig.restart_server("fr")
    rig.cycle()
    assert rig.state.cycle == 1
    assert rig.request().reasons[0].code is ReasonCode.NOT_READY


def test_a_restarted_robot_server_is_held_until_a_reset(rig):
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


# The gate's fingerprint: which code it is of.


def test_the_fingerprint_of_a_package_covers_its_subpackages() -> None:
    root = Path(deltaq_cell.__file__)
    found = {file.relative_to(root.parent).as_posix() for file in code_files(root)}
    assert {"proximity.py", "kernel/look.py", "kernel/gap.py", "description/cell.py"} <= found


def test_the_fingerprint_of_a_module_covers_its_file_alone() -> None:
    brake = Path(deltaq_protocol.brake.__file__)
    assert code_files(brake) == [brake]


# All that the SIM's core says, field by field, and to whom.

CYCLE_S = CELL.description.cycle_s
GATE = CELL.description.gate
MAX_DV = CELL.robots["fr"].max_acceleration * CYCLE_S**2
TOO_NEAR = CELL.robots["fr"].home.copy()
TOO_NEAR[1] = np.deg2rad(21.6)  # brings link 3 within the stop distance of the floor
DOWN = (0.0, 1e-4, 0.0, 0.0, 0.0, 0.0)


def next_state(rig, robot="fr", **changes):
    """The state that a robot at rest would publish next."""
    state = rig.servers[robot].state
    return state.model_copy(update={"cycle": state.cycle + 1, "time_s": state.time_s + CYCLE_S} | changes)


def ask(rig, seq=1, dq=SMALL, cycle=None, robot="fr"):
    cycle = rig.servers[robot].state.cycle if cycle is None else cycle
    return Request(robot=robot, cycle=cycle, lease_epoch=1, seq=seq, dq=dq)


def test_every_message_goes_to_its_own_handler_and_is_counted(rig):
    taken = rig.sim.taken
    assert isinstance(rig.sim.take(next_state(rig))[0].message, Supervision)
    assert isinstance(rig.sim.take(ask(rig))[-1].message, Verdict)
    io = bound(rig.sim, id=1, kind="io", robot="gr", outputs={"gripper": True})
    assert isinstance(rig.sim.take(io)[0].message, CommandReply)
    assert rig.sim.taken == taken + 3
    with pytest.raises(TypeError):
        rig.sim.take(Health(service="hli", healthy=True, time_s=0.0))


def test_a_new_gate_has_no_memory():
    sim = Sim(CELL, epoch=5)
    assert (sim.epoch, sim.taken, sim.counters) == (5, 0, {})
    assert sim.snapshot().sequence == 0
    assert sim.snapshot().receipt == first_receipt(sim.fingerprint, 5)


def test_an_unplaceable_message_is_counted_each_time_and_not_answered(rig):
    for _ in range(2):
        assert rig.sim.on_state(next_state(rig).model_copy(update={"robot": "nobody"})) == []
        assert rig.sim.on_state(next_state(rig, q=(0.0,) * 9)) == []
        assert rig.sim.on_request(Request(robot="nobody", cycle=1, lease_epoch=1)) == []
    assert (
        rig.sim.counters["unknown_state"],
        rig.sim.counters["unknown_request"],
    ) == (4, 2)


@pytest.mark.parametrize(("cycle", "decides"), [(0, False), (1, True)])
def test_before_a_robots_first_state_requests_wait(rig, cycle, decides):
    sim = Sim(CELL, epoch=5)
    assert sim.on_request(Request(robot="fr", cycle=cycle, lease_epoch=1)) == []
    assert sim.on_request(ask(rig, cycle=cycle)) == []
    answers = sim.on_state(rig.state.model_copy(update={"cycle": 1}))
    told = [output.message.reasons for output in answers if isinstance(output.message, Verdict)]
    assert told == ([(Reason(code=ReasonCode.NOT_READY, what="gr"),)] if decides else [])


def test_every_state_is_answered_with_supervision_even_a_repeated_one(rig):
    rig.sim.on_command(bound(rig.sim, id=3, kind="io", robot="gr", outputs={"gripper": True}))
    state = next_state(rig, robot="gr", resets=4, epoch=4)  # of a gate before this one
    expected = Supervision(
        robot="gr", epoch=5, cycle=state.cycle, resets=4, outputs={"gripper": True}, cell=state.cell
    )
    for _ in range(2):
        assert rig.sim.on_state(state) == [ToTopic(topics.SUPERVISION, "gr", expected)]
    assert rig.mail["fr"][1].outputs == {}


def test_a_stop_is_repeated_by_supervision_until_the_state_shows_it(rig):
    rig.sim.on_command(Command(id=3, kind="stop", robot="gr", reason=ReasonCode.HLI_LOST))
    assert rig.sim.on_state(next_state(rig, "gr"))[0].message.stop is ReasonCode.HLI_LOST
    assert rig.sim.on_state(next_state(rig))[0].message.stop is None
    held = next_state(rig, "gr", phase=Phase.HELD).model_copy(update={"cycle": 10_000})
    assert rig.sim.on_state(held)[0].message.stop is None


def test_a_repeated_state_can_show_that_a_reset_is_done(rig):
    assert rig.sim.on_command(bound(rig.sim, id=17, kind="reset", robot="fr")) == []
    done = rig.sim.on_state(rig.state)
    assert done[1:] == [ToTopic(topics.COMMAND_REPLY, "", CommandReply(id=17, accepted=True))]


def test_an_overtaken_state_is_answered_with_the_newest_supervision(rig):
    overtaken = rig.state
    rig.cycle()
    (supervised,) = rig.sim.on_state(overtaken)
    assert supervised.message.cycle == rig.state.cycle == overtaken.cycle + 1


def test_the_gate_s_times_are_whole_cycles_that_are_not_shorter(rig):
    for _ in range(20):
        rig.cycle()
    lag_cycles = math.ceil(GATE.servo_lag_s / CYCLE_S)
    assert len(rig.sim.robots["fr"].tracker.standing().points) == lag_cycles + 1
    rig.alive()
    for _ in range(math.ceil(GATE.hli_timeout_s / CYCLE_S)):
        rig.cycle()
        assert rig.mail["fr"][1].stop is None
    rig.cycle()
    assert rig.mail["fr"][1].stop is ReasonCode.HLI_LOST


def test_a_restarted_robot_server_is_stopped_and_its_cycles_count_from_one(rig):
    rig.sim.on_request(ask(rig))
    decided = rig.state.cycle
    again = next_state(rig, process=2, cycle=1)
    assert rig.sim.on_state(again)[0].message.stop is ReasonCode.SERVER_LOST
    held = again.model_copy(update={"cycle": decided - 1, "time_s": again.time_s + 1, "phase": Phase.HELD})
    assert rig.sim.on_state(held)[0].message.stop is None
    rig.sim.robots["fr"].orders.resets = 1  # the operator's
    changes = {"cycle": decided, "time_s": again.time_s + 2, "phase": Phase.READY, "resets": 1}
    ready = held.model_copy(update=changes)
    rig.sim.on_state(ready)
    assert rig.sim.on_request(ask(rig, seq=2, cycle=decided))[-1].message.outcome is Outcome.ADMITTED


def test_a_heartbeat_is_no_request(rig):
    assert rig.sim.on_request(Request(robot="fr", cycle=rig.state.cycle, lease_epoch=1)) == []


def test_an_admission_is_bound_to_the_state_it_was_decided_on(rig):
    for count, dq in enumerate([MAX_DV, 1.5 * MAX_DV], start=1):
        state = rig.state
        admission, _ = rig.sim.on_request(ask(rig, seq=count, dq=tuple(dq.tolist())))
        assert (admission.topic, admission.robot) == (topics.ADMISSION, "fr")
        expected = admission_after(state, dq, brake_cycles(dq, MAX_DV), epoch=5, sequence=count)
        assert admission.message == expected
        rig.deliver([admission])
        rig.cycle()
        assert rig.state.sequence == count


def test_admissions_to_one_robot_and_the_other_are_numbered_together(rig):
    first = rig.sim.on_request(ask(rig))[0].message
    second = rig.sim.on_request(ask(rig, robot="gr", dq=(1e-5,) * 9))[0].message
    assert (first.sequence, second.sequence) == (1, 2)


def test_an_admitted_request_gets_a_verdict_without_receipt(rig):
    state = rig.state
    output = rig.sim.on_request(ask(rig, seq=4, cycle=state.cycle - 2))[-1]
    verdict = output.message
    assert (output.topic, output.robot) == (topics.GATE_VERDICT, "fr")
    assert (verdict.robot, verdict.cycle, verdict.seq) == ("fr", state.cycle, 4)
    assert (verdict.outcome, verdict.scale, verdict.dq) == (Outcome.ADMITTED, 1.0, SMALL)
    assert (verdict.reasons, verdict.receipt, verdict.setpoint_cycle) == ((), None, state.cycle + 1)
    assert 0.05 < verdict.clearance_m < 1.0
    assert len(verdict.pair) == 2
    assert rig.sim.counters["admitted"] == 1


def test_a_scaled_request_gets_its_fraction_and_reason(rig):
    for count in (1, 2):
        admission, verdict = rig.sim.on_request(ask(rig, seq=count, dq=tuple((4 * MAX_DV).tolist())))
        scaled = verdict.message
        rig.deliver([admission])
        rig.cycle()
    assert scaled.outcome is Outcome.SCALED
    assert 0 < scaled.scale < 1
    assert scaled.dq == admission.message.dq
    assert scaled.time_to_stop_s == pytest.approx(admission.message.brake_cycles * CYCLE_S)
    assert scaled.reasons[0].code is ReasonCode.ACCELERATION_LIMIT
    assert scaled.receipt is None
    assert (
        rig.sim.counters["scaled"],
        rig.sim.counters["reason_acceleration_limit"],
    ) == (2, 2)


def test_a_held_request_gets_a_receipt_and_no_admission():
    rig = Rig(fr=TOO_NEAR)
    before = rig.sim.snapshot().receipt
    outputs = rig.sim.on_request(ask(rig, dq=DOWN))
    assert [output.topic for output in outputs] == [topics.GATE_VERDICT]
    held = outputs[0].message
    assert (held.outcome, held.scale, held.dq) == (Outcome.HELD, 0.0, (0.0,) * 6)
    assert held.setpoint_cycle is None
    assert "structure/floor" in held.pair
    assert held.clearance_m < 0.05
    assert held.receipt == rig.sim.snapshot().receipt == receipt_of(before, held)
    assert (rig.sim.counters["held"], rig.sim.counters["reason_retreat"]) == (1, 1)
    assert rig.sim.snapshot().sequence == 0


class Otherwise:
    """A gate whose decisions are those of another in all but a few fields."""

    def __init__(self, gate, **changes):
        self.gate, self.changes = gate, changes

    def decide(self, robot, others, request):
        return replace(self.gate.decide(robot, others, request), **self.changes)


def test_of_several_reasons_the_first_is_counted(rig):
    reasons = (Reason(code=ReasonCode.RETREAT), Reason(code=ReasonCode.CLEARANCE))
    rig.sim.gate = Otherwise(rig.sim.gate, reasons=reasons)
    assert rig.sim.on_request(ask(rig))[-1].message.reasons == reasons
    assert (
        rig.sim.counters["reason_retreat"],
        rig.sim.counters["reason_clearance"],
    ) == (1, 0)


def test_without_two_bodies_no_clearance_is_reported(rig):
    rig.sim.gate = Otherwise(rig.sim.gate, binding=None)
    verdict = rig.sim.on_request(ask(rig))[-1].message
    assert verdict.outcome is Outcome.ADMITTED
    assert (verdict.clearance_m, verdict.pair) == (None, None)


def test_refusals_are_links_of_one_chain_and_each_is_counted(rig):
    receipt = rig.sim.snapshot().receipt
    for count in (1, 2):
        output = rig.sim.on_request(ask(rig, seq=count, dq=(0.0,) * 7, cycle=3))[0]
        assert (output.topic, output.robot) == (topics.GATE_VERDICT, "fr")
        refused = output.message
        assert (refused.robot, refused.cycle, refused.seq) == ("fr", 3, count)
        assert (refused.outcome, refused.dq) == (Outcome.REFUSED, ())
        assert refused.reasons == (Reason(code=ReasonCode.BAD_SHAPE, what="dq", value=7, bound=6),)
        receipt = receipt_of(receipt, refused)
        assert refused.receipt == rig.sim.snapshot().receipt == receipt
    assert (rig.sim.counters["refused"], rig.sim.counters["reason_bad_shape"]) == (
        2,
        2,
    )


def test_nothing_is_admitted_to_a_robot_server_that_follows_another_gate(rig):
    rig.sim.on_state(next_state(rig, epoch=4))
    verdict = rig.sim.on_request(ask(rig))[-1].message
    assert verdict.reasons == (Reason(code=ReasonCode.NOT_READY, what="gate epoch"),)


def test_the_first_reason_for_a_robot_that_may_not_move_is_its_phase(rig):
    rig.sim.on_state(next_state(rig, epoch=4, phase=Phase.HELD))
    assert rig.sim.on_request(ask(rig))[-1].message.reasons == (Reason(code=ReasonCode.STOPPED),)
    alone = Sim(CELL, epoch=5)
    alone.on_state(next_state(rig, phase=Phase.OFFLINE))
    assert alone.on_request(ask(rig))[-1].message.reasons == (Reason(code=ReasonCode.NOT_READY),)


def test_a_refused_request_leaves_the_state_to_be_decided_for_the_next(rig):
    state = rig.state
    assert rig.sim.on_request(ask(rig, seq=1))[-1].message.outcome is Outcome.ADMITTED
    rig.sim.on_state(next_state(rig, cycle=state.cycle + 50))
    assert rig.sim.on_request(ask(rig, seq=2, cycle=1))[-1].message.outcome is Outcome.REFUSED
    assert rig.sim.on_request(ask(rig, seq=3, cycle=state.cycle + 50))[-1].message.outcome is Outcome.ADMITTED


def test_a_missed_admission_is_counted_for_its_robot(rig):
    rig.sim.on_request(ask(rig))
    rig.cycle()
    assert rig.sim.counters["missed_admissions_fr"] == 1
    assert rig.sim.counters["missed_admissions_gr"] == 0


def test_a_command_to_a_robot_that_is_not_here_is_refused_and_not_counted(rig):
    output = rig.sim.on_command(Command(id=8, kind="stop", robot="nobody"))[0]
    assert (output.topic, output.robot) == (topics.COMMAND_REPLY, "")
    reply = output.message
    assert (reply.id, reply.accepted, reply.code) == (8, False, ReasonCode.UNKNOWN_ROBOT)
    assert "nobody" in reply.message
    assert rig.sim.counters["command_stop"] == 0


def test_commands_are_counted_by_kind(rig):
    for _ in range(2):
        rig.sim.on_command(Command(id=8, kind="stop"))
    rig.sim.on_command(bound(rig.sim, id=9, kind="io", robot="gr", outputs={"gripper": True}))
    assert (rig.sim.counters["command_stop"], rig.sim.counters["command_io"]) == (
        2,
        1,
    )


def test_a_stop_refuses_only_the_waiting_request(rig):
    rig.sim.on_request(ask(rig, seq=1))
    rig.sim.on_request(ask(rig, seq=2))  # waits for the next state
    stopped = rig.sim.on_command(Command(id=8, kind="stop"))
    assert [(output.message.seq, output.message.reasons) for output in stopped] == [
        (2, (Reason(code=ReasonCode.STOPPED),))
    ]


def test_from_the_moment_of_a_stop_nothing_is_admitted(rig):
    rig.sim.on_command(Command(id=8, kind="stop", robot="fr"))
    assert rig.state.phase is Phase.READY  # it has not heard of it yet
    assert rig.sim.on_request(ask(rig))[-1].message.reasons == (Reason(code=ReasonCode.STOPPED),)


def test_a_refused_reset_is_reported_for_each_robot(rig):
    rig.sim.on_command(Command(id=8, kind="stop"))
    replies = [output.message for output in rig.sim.on_command(bound(rig.sim, id=9, kind="reset"))]
    assert [(reply.id, reply.accepted, reply.code) for reply in replies] == [
        (9, False, ReasonCode.NOT_AT_REST)
    ] * 2
    assert "fr" in replies[0].message + replies[1].message
    assert all(reply.message for reply in replies)


def test_the_last_decision_and_violations_are_restored_too():
    rig = Rig(fr=TOO_NEAR)
    assert rig.request(dq=tuple(-dq for dq in DOWN), seq=7).outcome is Outcome.ADMITTED  # it retreats
    memory = rig.sim.snapshot()
    fr = memory.robots["fr"]
    assert (fr.decided.seq, fr.spoken_cycle) == (7, rig.state.cycle)
    assert [kept.pair for kept in memory.violations] == [("fr/link_3", "structure/floor")]
    heir = Sim(CELL, epoch=9)
    heir.restore(memory)
    assert heir.snapshot() == memory


def test_a_restored_gate_gives_the_same_answers(rig):
    rig.request(seq=3, lease_epoch=2)
    rig.cycle()
    rig.request(seq=4, lease_epoch=2)
    rig.request(seq=5, lease_epoch=2)  # waits
    rig.sim.on_command(Command(id=8, kind="stop", robot="gr"))
    rig.request(dq=(0.0,) * 7)
    memory = rig.sim.snapshot()
    fr = memory.robots["fr"]
    assert (memory.epoch, memory.number, memory.sequence) == (5, rig.sim.taken, 2)
    assert (fr.waiting.seq, fr.decided_cycle, fr.lease_epoch, fr.seq) == (
        5,
        rig.state.cycle,
        2,
        5,
    )
    assert memory.robots["gr"].orders.standing_stop is ReasonCode.OPERATOR_STOP
    heir = Sim(CELL, epoch=9)
    heir.restore(memory)
    assert heir.snapshot() == memory
    assert heir.taken == memory.number
    state = next_state(rig)
    for message in (
        state,
        ask(rig, seq=5),
        bound(rig.sim, id=3, kind="reset", robot="gr"),
    ):
        assert heir.take(message) == rig.sim.take(message)
    assert heir.snapshot() == rig.sim.snapshot()


def test_robots_without_a_state_have_no_nearest_pair():
    assert Sim(CELL, epoch=5).nearest() is None


def test_the_nearest_pair_is_of_robots_with_a_state(rig):
    alone = Sim(CELL, epoch=5)
    alone.on_state(next_state(rig, "gr"))
    assert not any(name.startswith("fr") for name in alone.nearest().pair)


@pytest.mark.parametrize(
    ("fr", "gr", "pair"),
    [
        (TOO_NEAR, CELL.robots["gr"].home, {"fr/link_3", "structure/floor"}),
        (
            (-0.874, -0.806, 0.250, -1.742, 0.600, 2.117),
            (0.860, 1.820, -0.602, 0.577, -1.549, -0.785, 0.551, 0.490, 1.334),
            {"fr/link_1", "gr/link_3"},
        ),
    ],
)
def test_the_nearest_pair_is_measured_at_the_setpoints(rig, fr, gr, pair):
    here = {"fr": np.array(fr), "gr": np.array(gr)}
    sim = Sim(CELL, epoch=5)
    for name, q in here.items():
        sim.on_state(next_state(rig, name, q_cmd=tuple(q.tolist())))
    near, truth = sim.nearest(), ClearanceOracle(CELL)
    assert set(near.pair) == pair
    nearest = min(
        truth.between_robots_and_structure(here), truth.of_one_robot(here), key=lambda item: item.distance_m
    )
    assert near.distance_m == pytest.approx(nearest.distance_m, abs=1e-3)
