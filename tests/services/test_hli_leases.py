"""Who may write to a robot, and what happens when the one who may is gone."""

from typing import Any

import pytest
from test_hli_core import Bench, only, refused, sent

from deltaq_protocol.guarded import Command, CommandReply, Request
from deltaq_protocol.messages import Error, IoRequest, Outcome, Phase, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.outputs import Output


@pytest.fixture
def bench() -> Bench:
    return Bench().ready()


def controller_lost(outputs: list[Output]) -> bool:
    commands = sent(Command, outputs)
    assert all((c.kind, c.robot, c.reason) == ("stop", "fr", ReasonCode.CONTROLLER_LOST) for c in commands)
    return len(commands) == 1


def test_a_second_client_is_refused_with_the_holders_name_and_the_time_left(bench: Bench) -> None:
    bench.now += 0.25
    reply = bench.lease(client="intruder")
    assert (reply.granted, reply.code, reply.holder) == (False, ReasonCode.LEASE_TAKEN, "octave")
    assert reply.expires_s == pytest.approx(0.75)
    assert reply.lease is None


def test_the_lease_of_a_robot_that_the_cell_does_not_have_is_refused() -> None:
    assert Bench().lease(robot="ghost").code is ReasonCode.UNKNOWN_ROBOT


@pytest.mark.parametrize("action", ["renew", "release"])
def test_only_the_holder_renews_and_releases(bench: Bench, action: str) -> None:
    reply = bench.lease(action, lease="token-of-another")
    assert (reply.granted, reply.code, reply.holder) == (False, ReasonCode.LEASE_NOT_HELD, "octave")


def test_a_lease_runs_out_when_nothing_renews_it(bench: Bench) -> None:
    bench.now += 1.0
    assert bench.lease("renew", lease=bench.token).code is ReasonCode.LEASE_NOT_HELD
    assert bench.core.counters["leases_expired"] == 1


def test_a_client_that_loses_a_lease_by_silence_gets_bound_and_remedy(bench: Bench) -> None:
    bench.now += 1.0
    error = only(Error, bench.core.on_tick(bench.now))
    assert (error.code, error.robot, error.request) == (ReasonCode.LEASE_NOT_HELD, "fr", None)
    assert error.message == "the lease of fr has run out: octave sent nothing for 1 s"
    assert "renew" in error.hint
    assert "acquire" in error.hint


def test_a_line_does_not_renew_an_expired_lease(bench: Bench) -> None:
    assert bench.token is not None
    bench.now += 1.0
    assert only(Error, bench.core.requests.on_heard([("fr", bench.token)], bench.now)).robot == "fr"
    assert not bench.lease("renew", lease=bench.token).granted


def test_a_line_of_a_former_holder_does_not_renew_the_next_lease(bench: Bench) -> None:
    former, bench.token = bench.token, None
    assert former is not None
    bench.lease("take")
    bench.now += 0.9
    assert bench.core.requests.on_heard([("fr", former)], bench.now) == []
    bench.now += 0.1
    assert not bench.lease("renew", lease=bench.token).granted


def test_a_copy_of_an_increment_does_not_renew_the_lease(bench: Bench) -> None:
    bench.move(1)
    bench.now += 0.9
    assert refused(bench.move(1)).code is ReasonCode.REPLAYED_SEQUENCE
    bench.now += 0.1
    assert not bench.lease("renew", lease=bench.token).granted


def test_a_renewal_and_an_accepted_increment_both_renew_the_lease(bench: Bench) -> None:
    bench.now += 0.9
    assert bench.lease("renew", lease=bench.token).expires_s == pytest.approx(1.0)
    bench.now += 0.9
    bench.state(101)
    assert only(Request, bench.move(1, cycle=101)).seq == 1
    bench.now += 0.9
    assert bench.lease("renew", lease=bench.token).granted


@pytest.mark.parametrize(
    "bad",
    [{}, {"cycle": 1}, {"cycle": 200}, {"dq": (0.0,) * 7}, {"dq": [None] * 6}, {"dq": "fast"}],
    ids=["not heard", "stale", "future", "long", "not finite", "no list"],
)
def test_a_refused_increment_renews_the_lease(bench: Bench, bad: dict[str, Any]) -> None:
    bench.now += 0.9
    bench.move(1, **bad)  # its robot is not heard any more, whatever else is wrong with it
    assert bench.core.counters["requests"] == 0
    bench.now += 0.9
    assert bench.lease("renew", lease=bench.token).granted


def test_reading_or_setting_outputs_renews_the_lease(bench: Bench) -> None:
    bench.now += 0.9
    bench.core.requests.on_io(IoRequest(robot="fr", lease=bench.token), bench.client, bench.now)
    bench.now += 0.9
    assert bench.lease("renew", lease=bench.token).granted


def test_acquiring_again_with_the_token_renews_and_keeps_the_epoch(bench: Bench) -> None:
    assert bench.lease(lease=bench.token).granted
    assert only(Request, bench.move(1)).lease_epoch == 1001


def test_every_grant_has_an_epoch_and_a_token_of_its_own_and_begins_with_any_sequence_number() -> None:
    bench = Bench().ready()
    tokens, epochs = {bench.token}, []
    for cycle in (101, 102, 103):
        bench.state(cycle)
        epochs.append(only(Request, bench.move(7, cycle=cycle)).lease_epoch)
        bench.lease("release", lease=bench.token)
        bench.lease()
        tokens.add(bench.token)
    assert epochs == [1001, 1002, 1003]
    assert len(tokens) == 4


def test_taking_a_lease_moves_it_and_the_former_holder_learns_at_the_next_increment(bench: Bench) -> None:
    former = bench.token
    bench.token = None
    assert bench.lease("take", client="operator").holder == "operator"
    assert bench.core.counters["leases_taken"] == 1
    assert refused(bench.move(1, lease=former)).code is ReasonCode.LEASE_NOT_HELD
    assert only(Request, bench.move(1)).lease_epoch == 1002


def test_taking_a_lease_does_not_stop_the_robot(bench: Bench) -> None:
    bench.move(1)
    bench.token = None
    bench.lease("take")
    assert not sent(Command, bench.core.on_tick(bench.now))


def test_releasing_a_lease_drops_the_waiting_increment_without_a_stop(bench: Bench) -> None:
    bench.move(1)
    bench.move(2)
    reply = bench.lease("release", lease=bench.token)
    assert (reply.granted, reply.holder, reply.lease) == (True, None, None)
    outputs = bench.state(101, phase=Phase.ENGAGED)
    assert [r.dq for r in sent(Request, outputs)] == [None]
    assert not sent(Command, outputs)


def test_a_holder_that_falls_silent_in_motion_holds_the_robot_as_controller_lost(bench: Bench) -> None:
    bench.move(1)
    bench.move(2)
    bench.now += 1.0
    outputs = bench.core.on_tick(bench.now)
    assert controller_lost(outputs)
    assert only(Verdict, outputs).reasons[0].code is ReasonCode.LEASE_NOT_HELD
    assert [r.dq for r in sent(Request, bench.state(101))] == [None]


@pytest.mark.parametrize("phase", [Phase.ENGAGED, Phase.BRAKING])
def test_a_broken_connection_stops_a_moving_robot_without_increments(
    phase: Phase,
) -> None:
    bench = Bench().ready()
    bench.state(101, phase=phase)
    assert bench.token is not None
    assert controller_lost(bench.core.requests.on_connection_lost([("fr", bench.token)], bench.now))


def test_a_holder_that_never_moved_its_robot_may_disconnect(bench: Bench) -> None:
    assert bench.token is not None
    assert bench.core.requests.on_connection_lost([("fr", bench.token)], bench.now) == []
    assert bench.lease(client="next").granted


def test_a_connection_that_breaks_after_its_lease_was_taken_stops_nothing(bench: Bench) -> None:
    bench.move(1)
    former, bench.token = bench.token, None
    bench.lease("take")
    assert former is not None
    assert bench.core.requests.on_connection_lost([("fr", former)], bench.now) == []


def test_a_lost_controller_without_a_gate_is_counted_and_its_robot_stopped_later(bench: Bench) -> None:
    bench.move(1)
    stop = only(Command, bench.core.on_tick(bench.now + 1.0))
    assert bench.core.on_tick(bench.now + 1.05) == []
    assert sent(Command, bench.core.on_tick(bench.now + 1.1)) == [stop]
    bench.now += 1.5
    assert sent(Command, bench.core.on_tick(bench.now)) == [stop]  # given up by nobody, though counted
    assert bench.core.counters["commands_unanswered"] == 1
    assert bench.core.counters["stops_sent_again"] == 2
    bench.core.on_command_reply(CommandReply(id=stop.id, accepted=True))
    assert bench.core.on_tick(bench.now + 60.0) == []


def test_a_reacquired_lease_does_not_cancel_the_stop_for_its_silence(bench: Bench) -> None:
    bench.move(1)
    bench.now += 1.0
    stop = only(Command, bench.core.on_tick(bench.now))  # lost on its way
    assert bench.lease(client="octave").granted
    bench.state(101)
    bench.move(2, cycle=101)
    bench.now += 0.1
    assert sent(Command, bench.state(102)) == [stop]


def test_an_hli_with_a_set_back_clock_continues_from_the_epochs_of_the_gate(bench: Bench) -> None:
    stale = only(Request, bench.move(1)).lease_epoch
    known = Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease_epoch", value=stale, bound=5_000)
    refusal = Verdict(robot="fr", cycle=100, seq=1, outcome=Outcome.REFUSED, reasons=(known,))
    bench.core.on_gate_verdict(refusal)
    bench.state(101)
    assert refused(bench.move(2, cycle=101)).code is ReasonCode.LEASE_NOT_HELD  # the client asks for it again
    assert bench.lease(client="octave").granted
    assert only(Request, bench.move(3, cycle=101)).lease_epoch == 5_001
    assert bench.core.counters["leases_outdated"] == 1


def test_a_refusal_for_an_epoch_that_was_granted_here_ends_no_lease(bench: Bench) -> None:
    bench.move(1)
    known = Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease_epoch", value=900, bound=1_001)
    bench.core.on_gate_verdict(
        Verdict(robot="fr", cycle=90, seq=1, outcome=Outcome.REFUSED, reasons=(known,))
    )
    bench.state(101)
    assert only(Request, bench.move(2, cycle=101)).lease_epoch == 1_001
