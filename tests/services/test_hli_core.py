"""The core of the HLI in virtual time: what is refused, what is passed on, and when."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from small_cell import server_state, small_cell, told, tool_pose

from deltaq_protocol import topics
from deltaq_protocol.audit import AuditKind
from deltaq_protocol.codec import InvalidMessageError, from_map, to_line
from deltaq_protocol.guarded import Command, CommandReply, Health, Request
from deltaq_protocol.messages import (
    ContactRequest,
    Done,
    DryRunReply,
    DryRunRequest,
    Error,
    Increment,
    IoReply,
    IoRequest,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    NearestPair,
    Outcome,
    Phase,
    Proximity,
    ResetRequest,
    RobotState,
    StopRequest,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Realm
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.commands import MOST_AWAIT_A_STOP, Deed
from deltaq_services.hli.core import HliCore
from deltaq_services.hli.state import MOST_COMMANDS_S
from deltaq_services.outputs import Output, Sender, ToSender, ToTopic, published

CYCLE_S = 0.012


class Client(Sender):
    lasting = True

    def deliver(self, message):
        raise AssertionError("the core only hands it back")


class Bench:
    """A core, a clock, and what came out of it since it was last asked."""

    def __init__(self, operator_token: str | None = None) -> None:
        cell = small_cell()
        tokens = (f"token-{k}" for k in itertools.count())
        roles, self.deeds = ClientRoles(operator_token), list[Deed]()
        self.core = HliCore(cell, told(cell), tool_pose, lambda: next(tokens), 1000, roles, self.deeds.append)
        self.now = 50.0
        self.client = Client()
        self.token: str | None = None

    def state(self, cycle: int = 100, robot: str = "fr", **changes: Any) -> list[Output]:
        return self.core.on_server_state(server_state(robot, cycle, **changes), self.now)

    def lease(self, action: str = "acquire", robot: str = "fr", **fields: Any) -> LeaseReply:
        request = LeaseRequest(robot=robot, action=LeaseAction(action), **fields)
        reply = only(LeaseReply, self.core.requests.on_lease(request, self.client, self.now))
        if reply.granted and action != "release":
            self.token = reply.lease
        return reply

    def move(self, seq: int, cycle: int = 100, **changes: Any) -> list[Output]:
        fields = {"robot": "fr", "seq": seq, "cycle": cycle, "dq": (0.001,) * 6, "lease": self.token}
        try:
            increment = from_map(Increment, fields | changes)
        except InvalidMessageError as error:
            return self.core.increments.on_bad_increment(error, self.client, self.now)
        return self.core.increments.on_increment(increment, self.client, self.now)

    def ready(self) -> Bench:
        self.state(100)
        self.lease(client="octave")
        return self


@pytest.fixture
def bench() -> Bench:
    return Bench()


def sent(kind: type[Message], outputs: list[Output]) -> list[Any]:
    return [output.message for output in outputs if isinstance(output.message, kind)]


def only(kind: type[Message], outputs: list[Output]) -> Any:
    found = [o.message for o in outputs if isinstance(o.message, kind) and not published([o], Realm.OPEN)]
    assert len(found) == 1, outputs
    return found[0]


def refused(outputs: list[Output]) -> Any:
    """The reason of the one refusal that the sender was told of; nothing went to the gate."""
    assert not published(outputs, Realm.GUARDED)
    verdict = only(Verdict, outputs)
    assert verdict.outcome is Outcome.REFUSED
    assert verdict.dq == ()
    return verdict.reasons[0]


# --- increments: the bad cases first ----------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, None])
def test_a_non_finite_element_is_refused_with_its_joint(bad: float | None) -> None:
    bench = Bench().ready()
    reason = refused(bench.move(1, dq=[0.0, 0.0, bad, 0.0, 0.0, 0.0]))
    assert (reason.code, reason.what) == (ReasonCode.NOT_FINITE, "a3")
    assert bench.core.counters["refused_not_finite"] == 1


@pytest.mark.parametrize("length", [0, 5, 7, 33])
def test_a_dq_of_the_wrong_length_is_refused_with_both_lengths(length: int) -> None:
    bench = Bench().ready()
    reason = refused(bench.move(1, dq=[0.0] * length))
    assert (reason.code, reason.value, reason.bound) == (ReasonCode.BAD_SHAPE, length, 6)


def test_an_increment_that_answers_a_cycle_more_than_ten_old_is_stale() -> None:
    bench = Bench().ready()
    reason = refused(bench.move(1, cycle=89))
    assert (reason.code, reason.value, reason.bound) == (ReasonCode.STALE_CYCLE, 89, 90)
    assert only(Request, bench.move(2, cycle=90)).seq == 2


def test_an_increment_for_a_future_cycle_is_refused() -> None:
    reason = refused(Bench().ready().move(1, cycle=101))
    assert (reason.code, reason.value, reason.bound) == (ReasonCode.FUTURE_CYCLE, 101, 100)


@pytest.mark.parametrize("seq", [4, 5])
def test_a_sequence_number_not_above_the_last_is_refused(seq: int) -> None:
    bench = Bench().ready()
    bench.move(5)
    bench.state(101)
    reason = refused(bench.move(seq, cycle=101))
    assert (reason.code, reason.bound) == (ReasonCode.REPLAYED_SEQUENCE, 5)


def test_a_refused_increment_uses_up_its_sequence_number() -> None:
    bench = Bench().ready()
    refused(bench.move(1, dq=[math.nan] * 6))
    assert refused(bench.move(1)).code is ReasonCode.REPLAYED_SEQUENCE


def test_an_unknown_robot_is_refused_by_name() -> None:
    reason = refused(Bench().ready().move(1, robot="ghost"))
    assert (reason.code, reason.what) == (ReasonCode.UNKNOWN_ROBOT, "ghost")


@pytest.mark.parametrize("token", [None, "", "token-7"])
def test_without_the_lease_an_increment_is_refused(token: str | None) -> None:
    assert refused(Bench().ready().move(1, lease=token)).code is ReasonCode.LEASE_NOT_HELD


def test_the_lease_of_one_robot_does_not_move_the_other() -> None:
    bench = Bench().ready()
    bench.state(100, "gr")
    assert refused(bench.move(1, robot="gr", dq=[0.0] * 9)).code is ReasonCode.LEASE_NOT_HELD


def test_a_damaged_increment_without_the_lease_is_refused_for_the_lease() -> None:
    assert refused(Bench().ready().move(1, lease="x", dq=[math.nan])).code is ReasonCode.LEASE_NOT_HELD


@pytest.mark.parametrize(
    ("phase", "code"), [(Phase.OFFLINE, ReasonCode.NOT_READY), (Phase.HELD, ReasonCode.STOPPED)]
)
def test_a_robot_that_is_offline_or_held_takes_no_increment(phase: Phase, code: ReasonCode) -> None:
    bench = Bench().ready()
    bench.state(101, phase=phase, reason=ReasonCode.OPERATOR_STOP)
    assert refused(bench.move(1, cycle=101)).code is code


def test_a_robot_without_a_state_is_not_ready(bench: Bench) -> None:
    bench.lease()
    assert refused(bench.move(1)).code is ReasonCode.NOT_READY


def test_a_robot_with_old_states_is_not_ready_and_the_age_is_reported() -> None:
    bench = Bench().ready()
    bench.now += 0.2
    reason = refused(bench.move(1))
    assert (reason.code, reason.bound) == (ReasonCode.NOT_READY, 0.12)
    assert reason.value == pytest.approx(0.2)


def test_a_malformed_increment_gets_an_error_and_no_verdict() -> None:
    bench = Bench().ready()
    outputs = bench.move(1, extra=1, type="increment")
    error = only(Error, outputs)
    assert error.code is ReasonCode.MALFORMED
    assert "extra" in error.message
    assert (error.request, error.robot, error.seq) == ("increment", "fr", 1)
    assert not sent(Verdict, outputs)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"type": "io", "robot": "gr", "outputs": "all"}, ("io", "gr", None)),
        ({"type": "io", "robot": 7, "seq": 3}, ("io", None, 3)),
        ({"type": "x" * 100, "robot": "y" * 100, "seq": 1.5}, ("x" * 64, "y" * 64, None)),
        ({"type": ["io"], "robot": None, "seq": True}, (None, None, None)),
        ({}, (None, None, None)),
    ],
)
def test_an_error_names_its_request_as_far_as_known(
    given: dict[str, Any], named: tuple[str | None, str | None, int | None]
) -> None:
    bench = Bench()
    malformed = InvalidMessageError("bad", ReasonCode.MALFORMED, given)
    error = only(Error, bench.core.increments.on_malformed(malformed, bench.client))
    assert (error.request, error.robot, error.seq) == named


def test_refused_increments_are_shown_to_every_watcher() -> None:
    outputs = Bench().ready().move(1, cycle=101)
    shown = published(outputs, Realm.OPEN)
    assert [(o.topic, o.robot) for o in shown] == [(topics.VERDICT, "fr")]


# --- one increment a robot and cycle ----------------------------------------------------------------


def test_an_increment_goes_to_the_gate_at_once_under_the_epoch_of_its_lease() -> None:
    bench = Bench().ready()
    request = only(Request, bench.move(1))
    assert request == Request(robot="fr", cycle=100, newest=100, lease_epoch=1001, seq=1, dq=(0.001,) * 6)


def test_a_second_increment_in_a_cycle_waits_for_the_next_state_and_replaces_the_heartbeat() -> None:
    bench = Bench().ready()
    bench.move(1)
    assert bench.move(2) == []
    requests = sent(Request, bench.state(101))
    assert [(r.seq, r.cycle, r.newest, r.dq is None) for r in requests] == [(2, 100, 101, False)]


def test_of_several_waiting_increments_the_newest_is_sent_and_the_others_are_superseded() -> None:
    bench = Bench().ready()
    bench.move(1)
    bench.move(2)
    told_of_2 = refused(bench.move(3))
    assert told_of_2.code is ReasonCode.SUPERSEDED
    assert bench.core.counters["refused_superseded"] == 1
    assert [r.seq for r in sent(Request, bench.state(101))] == [3]


def test_never_more_than_one_increment_goes_to_the_gate_for_a_cycle() -> None:
    bench = Bench().ready()
    outputs = [output for seq in range(1, 40) for output in bench.move(seq)]
    outputs += bench.state(101)
    outputs += [output for seq in range(40, 80) for output in bench.move(seq, cycle=101)]
    assert len(sent(Request, outputs)) == 2


def test_every_state_without_a_waiting_increment_sends_a_heartbeat(bench: Bench) -> None:
    request = only(Request, bench.state(100))
    assert request == Request(robot="fr", cycle=100, lease_epoch=0)


def in_step(**changes: Any) -> Bench:
    """The increment that answers the state of cycle 100 was decided in that cycle; what of it is not so?"""
    bench = Bench().ready()
    bench.move(1)
    if not changes.get("undecided"):
        bench.core.on_gate_verdict(Verdict(robot="fr", cycle=100, seq=1, outcome=Outcome.ADMITTED))
    return bench


def test_an_increment_taken_in_its_cycle_is_followed_by_no_heartbeat() -> None:
    bench = in_step()
    assert sent(Request, bench.state(101, sequence=2)) == []
    assert [r.seq for r in sent(Request, bench.move(2, cycle=101))] == [2]


@pytest.mark.parametrize(
    ("undecided", "cycle", "sequence"),
    [(True, 101, 2), (False, 101, 1), (False, 102, 2), (False, 100, 2)],
    ids=["no verdict yet", "not taken", "a state was lost", "the same state again"],
)
def test_any_other_increment_is_followed_by_a_heartbeat(undecided: bool, cycle: int, sequence: int) -> None:
    bench = in_step(undecided=undecided)
    assert [r.dq for r in sent(Request, bench.state(cycle, sequence=sequence))] == [None]


def test_a_silent_controller_is_followed_by_a_heartbeat_in_the_next_cycle() -> None:
    bench = in_step()
    bench.state(101, sequence=2)
    assert [r.dq for r in sent(Request, bench.state(102, sequence=2))] == [None]


def test_a_waiting_increment_that_becomes_stale_is_refused_and_a_heartbeat_sent() -> None:
    bench = Bench().ready()
    bench.move(1)
    bench.move(2)
    outputs = bench.state(200)
    assert [r.dq for r in sent(Request, outputs)] == [None]
    assert only(Verdict, outputs).reasons[0].code is ReasonCode.STALE_CYCLE


def test_an_increment_waits_for_one_state_and_not_for_the_one_after_it() -> None:
    bench = Bench().ready()
    bench.move(1)
    bench.move(2)
    outputs = bench.state(102)
    assert [r.dq for r in sent(Request, outputs)] == [None]
    reason = only(Verdict, outputs).reasons[0]
    assert (reason.code, reason.value, reason.bound) == (ReasonCode.STALE_CYCLE, 100, 101)


def test_an_increment_that_waits_when_the_robot_is_held_is_refused() -> None:
    bench = Bench().ready()
    bench.move(1)
    bench.move(2)
    outputs = bench.state(101, phase=Phase.HELD)
    assert [r.dq for r in sent(Request, outputs)] == [None]
    assert only(Verdict, outputs).reasons[0].code is ReasonCode.STOPPED


def test_a_robot_server_restarting_from_zero_is_followed() -> None:
    bench = Bench().ready()
    bench.move(1)
    bench.move(2)
    assert only(Verdict, bench.state(0)).reasons[0].code is ReasonCode.FUTURE_CYCLE
    assert only(Request, bench.move(3, cycle=0)).cycle == 0


def test_a_repeated_state_lets_no_second_increment_through() -> None:
    bench = Bench().ready()
    bench.move(1)
    bench.move(2)
    assert [r.dq for r in sent(Request, bench.state(100))] == [None]
    assert [r.seq for r in sent(Request, bench.state(101))] == [2]


def test_a_state_of_a_robot_or_shape_that_the_cell_does_not_have_is_ignored_and_counted(bench: Bench) -> None:
    assert bench.state(100, "ghost") == []
    assert bench.state(100, q=(0.0,) * 7) == []
    assert bench.core.counters["states_ignored"] == 2


def test_a_state_is_published_with_the_pose_of_the_tool() -> None:
    state = published(Bench().state(100), Realm.OPEN)[0]
    assert isinstance(state.message, RobotState)
    assert state.message.tool.position == (0.0, 0.0, 0.1)


# --- verdicts ---------------------------------------------------------------------------------------


def verdict(seq: int, outcome: Outcome = Outcome.ADMITTED) -> Verdict:
    return Verdict(robot="fr", cycle=100, seq=seq, outcome=outcome, scale=1.0, dq=(0.001,) * 6)


def test_a_verdict_goes_to_its_sender_and_to_every_watcher() -> None:
    bench = Bench().ready()
    bench.move(1)
    outputs = bench.core.on_gate_verdict(verdict(1))
    assert outputs == [ToSender(bench.client, verdict(1)), ToTopic(topics.VERDICT, "fr", verdict(1))]


def test_a_late_verdict_goes_to_its_sender_not_to_the_next_holder() -> None:
    bench = Bench().ready()
    bench.move(1)
    first, bench.client = bench.client, Client()
    bench.lease("take")
    told_to = [o.sender for o in bench.core.on_gate_verdict(verdict(1)) if isinstance(o, ToSender)]
    assert told_to == [first]


def test_a_verdict_on_a_robot_that_the_cell_does_not_have_is_ignored() -> None:
    assert Bench().core.on_gate_verdict(verdict(1).model_copy(update={"robot": "ghost"})) == []


# --- stop, reset, outputs ---------------------------------------------------------------------------


def test_a_stop_is_commanded_at_once_and_done_on_the_reply_of_the_gate(bench: Bench) -> None:
    command = only(Command, bench.core.requests.on_stop(StopRequest(), bench.client, bench.now))
    assert (command.kind, command.robot, command.reason) == ("stop", None, ReasonCode.OPERATOR_STOP)
    done = bench.core.on_command_reply(CommandReply(id=command.id, accepted=True))
    assert done == [ToSender(bench.client, Done(what="stop"))]


def test_a_stop_drops_the_waiting_increment() -> None:
    bench = Bench().ready()
    bench.move(1)
    bench.move(2)
    outputs = bench.core.requests.on_stop(StopRequest(), bench.client, bench.now)
    assert only(Verdict, outputs).reasons[0].code is ReasonCode.STOPPED
    assert [r.dq for r in sent(Request, bench.state(101))] == [None]


def test_a_gate_that_does_not_answer_a_stop_within_half_a_second_is_reported_unreachable() -> None:
    bench = Bench()
    bench.core.requests.on_stop(StopRequest(), bench.client, bench.now)
    assert sent(Error, bench.core.on_tick(bench.now + 0.49)) == []
    assert only(Error, bench.core.on_tick(bench.now + 0.5)).code is ReasonCode.UNREACHABLE
    assert bench.core.counters["commands_unanswered"] == 1


def test_the_newest_unanswered_stop_of_each_robot_is_repeated(bench: Bench) -> None:
    stop = only(Command, bench.core.requests.on_stop(StopRequest(), bench.client, bench.now))
    for _ in range(MOST_AWAIT_A_STOP - 1):
        assert (
            bench.core.requests.on_stop(StopRequest(), bench.client, bench.now) == []
        )  # they join the one under way
    for _ in range(1000):
        stops = sent(Command, bench.core.requests.on_stop(StopRequest(), bench.client, bench.now))
        stop = stops[0] if stops else stop
    assert sent(Command, bench.core.on_tick(bench.now + 0.1)) == [stop]


def test_every_client_that_stops_gets_an_answer_though_the_gate_gets_one_stop(bench: Bench) -> None:
    clients = [Client() for _ in range(MOST_AWAIT_A_STOP)]
    (stop,) = (
        c
        for who in clients
        for c in sent(Command, bench.core.requests.on_stop(StopRequest(), who, bench.now))
    )
    told = bench.core.on_command_reply(CommandReply(id=stop.id, accepted=True))
    assert [output.sender for output in told if isinstance(output.message, Done)] == clients


def test_a_stop_after_a_reset_joins_none_from_before_it(bench: Bench) -> None:
    bench.core.requests.on_stop(StopRequest(), bench.client, bench.now)
    bench.core.requests.on_reset(ResetRequest(robot="fr"), bench.client, bench.now)
    assert only(Command, bench.core.requests.on_stop(StopRequest(), bench.client, bench.now)).kind == "stop"


def test_a_flood_of_commands_reaches_the_gate_at_a_rate_and_no_stop_waits_for_it(bench: Bench) -> None:
    asked = [
        bench.core.requests.on_reset(ResetRequest(robot="fr"), bench.client, bench.now) for _ in range(500)
    ]
    assert len([c for outputs in asked for c in sent(Command, outputs)]) == MOST_COMMANDS_S
    assert only(Error, asked[-1]).code is ReasonCode.TOO_MANY
    assert only(Command, bench.core.requests.on_stop(StopRequest(), bench.client, bench.now)).kind == "stop"
    later = bench.core.requests.on_reset(ResetRequest(robot="fr"), bench.client, bench.now + 0.02)
    assert only(Command, later).kind == "reset"


def test_a_reply_after_the_deadline_answers_no_client_twice(bench: Bench) -> None:
    command = only(Command, bench.core.requests.on_stop(StopRequest(), bench.client, bench.now))
    bench.core.on_tick(bench.now + 1.0)
    assert bench.core.on_command_reply(CommandReply(id=command.id, accepted=True)) == []


@pytest.mark.parametrize("code", [ReasonCode.CAUSE_STANDS, ReasonCode.NOT_AT_REST])
def test_a_reset_that_the_gate_refuses_comes_back_with_its_reason_and_a_hint(code: ReasonCode) -> None:
    bench = Bench()
    outputs = bench.core.requests.on_reset(ResetRequest(robot="fr"), bench.client, bench.now)
    command = only(Command, outputs)
    error = only(Error, bench.core.on_command_reply(CommandReply(id=command.id, accepted=False, code=code)))
    assert error.code is code
    assert "reset of fr refused" in error.message
    assert (error.request, error.robot) == ("reset", "fr")
    assert "reset again" in error.hint


def test_a_reset_of_a_robot_that_the_cell_does_not_have_names_those_it_has(bench: Bench) -> None:
    error = only(Error, bench.core.requests.on_reset(ResetRequest(robot="ghost"), bench.client, bench.now))
    assert (error.code, error.hint) == (ReasonCode.UNKNOWN_ROBOT, "it has fr, gr")
    assert (error.request, error.robot) == ("reset", "ghost")


def test_with_an_operator_token_reset_and_take_need_it_and_stop_does_not() -> None:
    bench = Bench(operator_token="s3cret")
    bench.lease(client="octave")
    bench.token = None
    for token in (None, "", "wrong", "\ud800"):
        error = only(
            Error,
            bench.core.requests.on_reset(ResetRequest(robot="fr", token=token), bench.client, bench.now),
        )
        assert error.code is ReasonCode.NOT_PERMITTED
        assert bench.lease("take", token=token).code is ReasonCode.NOT_PERMITTED
    assert only(Command, bench.core.requests.on_stop(StopRequest(), bench.client, bench.now)).kind == "stop"
    right = ResetRequest(robot="fr", token="s3cret")
    assert only(Command, bench.core.requests.on_reset(right, bench.client, bench.now)).kind == "reset"
    assert bench.lease("take", token="s3cret").granted


def io(bench: Bench, **fields: Any) -> list[Output]:
    return bench.core.requests.on_io(IoRequest(robot="gr", **fields), bench.client, bench.now)


def test_an_output_that_the_robot_does_not_have_is_an_error_that_names_those_it_has() -> None:
    error = only(Error, io(Bench(), outputs={"grip": True}))
    assert error.message == "outputs: 'grip' is not an output of gr; it has gripper"


def test_an_invalid_name_is_answered_with_valid_text() -> None:
    error = only(Error, io(Bench(), outputs={"\ud800": True}))
    assert error.code is ReasonCode.MALFORMED
    assert to_line(error)


def test_only_the_holder_sets_outputs_of_a_leased_robot_and_any_client_reads_them(bench: Bench) -> None:
    bench.state(100, "gr")
    bench.lease(robot="gr", client="octave")
    assert only(Error, io(bench, outputs={"gripper": True})).code is ReasonCode.LEASE_NOT_HELD
    assert only(IoReply, io(bench)) == IoReply(
        robot="gr", outputs={"gripper": False}, inputs={"closed": True}
    )
    command = only(Command, io(bench, outputs={"gripper": True}, lease=bench.token))
    assert (command.kind, command.robot, command.outputs) == ("io", "gr", {"gripper": True})
    reply = only(IoReply, bench.core.on_command_reply(CommandReply(id=command.id, accepted=True)))
    assert reply.outputs == {"gripper": True}


def test_the_audit_log_keeps_notes_of_the_holder_alone(bench: Bench) -> None:
    bench.state(100, "gr")
    bench.lease(robot="gr", client="routine")
    io(bench, note="a stranger's")
    assert only(IoReply, io(bench, note="step 1: done", lease=bench.token))
    notes = [
        (deed.robot, deed.origin.client, deed.text) for deed in bench.deeds if deed.what is AuditKind.NOTE
    ]
    assert notes == [("gr", "routine", "step 1: done")]


# --- looking on -------------------------------------------------------------------------------------


def test_the_nearest_pair_is_published_only_when_the_gate_sends_it(bench: Bench) -> None:
    pair = NearestPair(pair=("fr/link_5", "floor"), distance_m=0.4, points_m=((0, 0, 0), (0, 0, 0.4)))
    cell = bench.core.description.identity
    health = Health(
        service="sim", healthy=True, time_s=1.0, nearest=pair, counters={"admitted": 3}, cell=cell
    )
    other = health.model_copy(update={"service": "robot-server-fr"})
    assert bench.core.on_health(other, bench.now) == []
    published = bench.core.on_health(health, bench.now)
    assert published == [ToTopic(topics.PROXIMITY, "", Proximity(time_s=1.0, pairs=(pair,)))]
    status = bench.core.status(bench.now + 0.5, bench.core.counters)
    assert (status.gate, status.gate_age_s, status.nearest) == ({"admitted": 3}, 0.5, pair)


def test_the_status_shows_a_robot_that_fell_silent_as_offline_with_the_age_of_its_state() -> None:
    bench = Bench().ready()
    status = bench.core.status(bench.now + 0.3, bench.core.counters)
    robot = status.robots["fr"]
    assert (robot.phase, robot.cycle, robot.lease.holder) == (Phase.OFFLINE, 100, "octave")
    assert robot.state_age_s == pytest.approx(0.3)
    assert status.robots["gr"].state_age_s is None
    assert status.lagging == (
        "fr: no server-state for 0.3 s, at most 0.12 s",
        "gr: no server-state yet",
        "sim: no health yet",
        "robot-server-fr: no health yet",
        "robot-server-gr: no health yet",
    )


# --- dry runs and contacts --------------------------------------------------------------------------


def test_a_dry_run_is_answered_with_the_gates_verdict(bench: Bench) -> None:
    asked = DryRunRequest(robot="fr", dq=(0.0,) * 6)
    command = only(Command, bench.core.requests.on_dry_run(asked, bench.client, bench.now))
    assert (command.kind, command.robot, command.dq) == ("dry_run", "fr", (0.0,) * 6)
    said = verdict(0)
    answer = bench.core.on_command_reply(CommandReply(id=command.id, accepted=True, verdict=said))
    assert answer == [ToSender(bench.client, DryRunReply(robot="fr", verdict=said))]


def test_a_dry_run_of_the_wrong_length_is_answered_with_the_joint_count(bench: Bench) -> None:
    asked = DryRunRequest(robot="fr", dq=(0.0,) * 5)
    error = only(Error, bench.core.requests.on_dry_run(asked, bench.client, bench.now))
    assert (error.code, error.message) == (ReasonCode.BAD_SHAPE, "dq has 5 elements, fr has 6 joints")


def test_a_contact_needs_a_name_of_the_cell_and_the_operators_token() -> None:
    bench = Bench(operator_token="open sesame")
    named = ContactRequest(contact="handshake", allowed=True, token="open sesame")
    assert (
        "no contact 'handshake'"
        in only(Error, bench.core.requests.on_contact(named, bench.client, 0.0)).message
    )
    bare = ContactRequest(contact="gripper_on_valves", allowed=True)
    error = only(Error, bench.core.requests.on_contact(bare, bench.client, bench.now))
    assert error.code is ReasonCode.NOT_PERMITTED
    entitled = bare.model_copy(update={"token": "open sesame"})
    command = only(Command, bench.core.requests.on_contact(entitled, bench.client, bench.now))
    assert (command.kind, command.contact, command.allowed) == ("contact", "gripper_on_valves", True)
    done = bench.core.on_command_reply(CommandReply(id=command.id, accepted=True))
    assert done == [ToSender(bench.client, Done(what="contact gripper_on_valves allowed"))]


# --- commands bound to the gate -----------------------------------------------------------------------


def out_of_turn(command: Command, code: str, epoch: int = 0, newest_id: int = 0) -> CommandReply:
    reason = ReasonCode(code)
    return CommandReply(id=command.id, accepted=False, code=reason, epoch=epoch, newest_id=newest_id)


def reset(bench: Bench) -> Command:
    request = ResetRequest(robot="fr")
    command: Command = only(Command, bench.core.requests.on_reset(request, bench.client, bench.now))
    return command


def test_a_command_names_the_newest_cycle_of_every_robot_with_a_state(bench: Bench) -> None:
    assert reset(bench).cycles == {}
    bench.state(7)
    bench.state(5, "gr")
    assert reset(bench).cycles == {"fr": 7, "gr": 5}


def test_a_command_without_the_epoch_of_the_gate_is_repeated_with_it(bench: Bench) -> None:
    first = reset(bench)
    second = only(Command, bench.core.on_command_reply(out_of_turn(first, "stale_epoch", 77)))
    assert (second.epoch, second.id, second.cycles) == (77, first.id + 1, first.cycles)
    assert only(Done, bench.core.on_command_reply(CommandReply(id=second.id, accepted=True)))
    assert reset(bench).epoch == 77


def test_a_new_hli_continues_from_the_command_ids_of_an_earlier_one(bench: Bench) -> None:
    first, second = reset(bench), reset(bench)
    again = [
        only(Command, bench.core.on_command_reply(out_of_turn(one, "replayed_sequence", newest_id=9_000)))
        for one in (first, second)
    ]
    assert [one.id for one in again] == [9_001, 9_002]


def test_commands_from_before_a_stop_are_not_repeated_after_it(bench: Bench) -> None:
    first = reset(bench)
    bench.core.requests.on_stop(StopRequest(), bench.client, bench.now)
    told = only(Error, bench.core.on_command_reply(out_of_turn(first, "stale_epoch", 77)))
    assert told.code is ReasonCode.STALE_EPOCH
    assert reset(bench).epoch == 77


def test_the_refusal_of_a_copy_is_no_answer_to_a_command(bench: Bench) -> None:
    command = reset(bench)
    assert bench.core.on_command_reply(out_of_turn(command, "replayed_sequence", newest_id=command.id)) == []
    assert only(Done, bench.core.on_command_reply(CommandReply(id=command.id, accepted=True)))


def test_a_late_command_is_reported_and_not_repeated(bench: Bench) -> None:
    told = only(Error, bench.core.on_command_reply(out_of_turn(reset(bench), "stale_cycle")))
    assert told.code is ReasonCode.STALE_CYCLE
