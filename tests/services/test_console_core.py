"""What the console's core decides, the bad cases first."""

import json
import math

import pytest
from console_bench import ConsoleBench

from deltaq_protocol import driving
from deltaq_protocol.messages import Outcome, Phase, Reason, Sight, Verdict, ViewTarget
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.console.commands import EXPIRY_S
from deltaq_services.console.messages import AckOutcome, Pong, StopPhase

REFUSED, EXPIRED, DONE, ASKED = AckOutcome.REFUSED, AckOutcome.EXPIRED, AckOutcome.DONE, AckOutcome.ASKED
JOG = {"robot": "fr", "wish": [0.1, 0, 0, 0, 0, 0]}


@pytest.fixture
def bench():
    return ConsoleBench()


@pytest.fixture
def driving_anna(bench):
    bench.states()
    desk = bench.browser("desk")
    desk.send("ping")
    desk.takes()
    return desk


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (b"\x00\x01", ("message", "text", "2 bytes")),
        ("{", ("message", "JSON")),
        ("[]", ("got []",)),
        ("null", ("got None",)),
        ('{"type": "fly", "id": "1", "sent_ms": 0}', ("type", "fly", "'ping'")),
        ('{"type": "jog"}', ("id: is missing",)),
        ('{"type": "jog", "id": "", "sent_ms": 0, "robot": "fr"}', ("id", "bound 1")),
        ('{"type": "ping", "id": "1", "sent_ms": NaN}', ("sent_ms", "finite")),
        ('{"type": "ping", "id": "1", "sent_ms": 0, "more": 1}', ("more: is not a field of a ping",)),
        ('{"type": "jog", "id": "1", "sent_ms": 0, "robot": "fr", "wish": [1e999]}', ("wish.0", "finite")),
        (
            '{"type": "jog", "id": "1", "sent_ms": 0, "robot": "fr", "wish": [' + "0," * 32 + "0]}",
            ("wish", "bound 32"),
        ),
        (
            '{"type": "view_distance", "id": "1", "sent_ms": 0, "robot": "fr", "value_m": 9}',
            ("value_m", "got 9", "4"),
        ),
        ("x" * 5000, ("5000 bytes", "4096")),
        ("[" * 4000, ("message",)),
        ('"\ud800"', ("message",)),
        ('{"type": "jog", "id": "c7", "sent_ms": 0, "robot": "fr", "wish": "all"}', ("wish",)),
    ],
)
def test_garbage_is_answered_with_field_value_and_bound_and_counted(bench, message, words):
    desk = bench.browser()
    desk.raw(message)
    assert desk.got[-1].outcome is REFUSED
    assert desk.got[-1].id == ("c7" if "c7" in str(message) else "1" if '"id": "1"' in str(message) else "")
    for word in words:
        assert word in desk.got[-1].text
    assert bench.core.counters["malformed"] == 1
    assert isinstance(desk.send("ping"), Pong)


def test_a_flood_is_refused_but_a_stop_in_it_is_not(bench):
    desk = bench.browser()
    pongs = [isinstance(desk.send("ping"), Pong) for _ in range(200)]
    assert sum(pongs) == 120
    assert "bound 120" in desk.got[-1].text
    assert desk.send("stop").outcome is ASKED
    assert bench.asked("stop")
    assert bench.core.counters["too_many"] == 80
    bench.now_s += 1.0
    assert isinstance(desk.send("ping"), Pong)


def test_a_flood_of_garbage_is_not_answered_message_by_message(bench):
    desk = bench.browser()
    for _ in range(200):
        desk.raw("garbage")
    assert len([ack for ack in desk.acks("") if ack.outcome is REFUSED]) == 120
    assert bench.core.counters["malformed"] == 200


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("lease", {"robot": "fr", "action": "take"}),
        ("lease", {"robot": "fr", "action": "take_over"}),
        ("jog", JOG),
        ("mode", {"robot": "fr", "mode": "follow"}),
        ("reset", {"robot": "fr"}),
        ("view_distance", {"robot": "fr", "value_m": 1.0}),
        ("look_at", {"robot": "fr", "targets": ["gr"]}),
        ("output", {"robot": "gr", "index": 0, "value": True}),
        ("dry_run", {"robot": "fr", "dq": [0, 0, 0, 0, 0, 0]}),
    ],
)
def test_an_observer_moves_nothing(kind, fields):
    bench = ConsoleBench(token_needed=True)
    bench.states()
    eve = bench.browser("eve", operator=False)
    ack = eve.send(kind, **fields)
    assert ack.outcome is REFUSED
    assert "observer" in ack.text
    assert not bench.driver_requests()
    assert not bench.asked("reset")
    assert not bench.asked("dry_run")


def test_an_observer_may_stop():
    bench = ConsoleBench(token_needed=True)
    eve = bench.browser("eve", operator=False)
    assert eve.send("stop").outcome is ASKED
    assert len(bench.asked("stop")) == 1


def test_a_late_motion_command_expires(driving_anna, bench):
    ack = driving_anna.send("jog", late_s=0.6, **JOG)
    assert ack.outcome is EXPIRED
    assert "0.60 s late; bound 0.5 s" in ack.text
    assert driving_anna.send("jog", late_s=0.4, **JOG).outcome is DONE
    assert len([each for each in bench.driver_requests() if each.id is None]) == 1


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_clock_an_hour_off_changes_nothing(driving_anna, bench, hours):
    tower = bench.browser("tower")
    tower.ahead_s = 3600.0 * hours
    tower.send("ping")
    tower.takes("gr")
    jog = {"robot": "gr", "wish": [0.0] * 9}
    assert tower.send("jog", **jog).outcome is DONE
    assert tower.send("jog", late_s=0.6, **jog).outcome is EXPIRED


def test_a_stop_needs_no_more_than_its_type(bench):
    bench.browser().raw('{"type": "stop"}')
    assert len(bench.asked("stop")) == 1


@pytest.mark.parametrize(
    ("kind", "fields", "words"),
    [
        ("jog", {"robot": "xy", "wish": []}, "no robot 'xy'; it has fr, gr"),
        ("jog", {"robot": "fr", "wish": [0.1]}, "fr has 6 joints, got 1"),
        ("jog", {"robot": "fr", "wish": [9, 0, 0, 0, 0, 0]}, "a1 at 9 rad/s; bound 2.72"),
        ("jog", {"robot": "fr", "hand": "left", "wish": [0] * 6}, "no hand 'left'; it has tool"),
        ("jog", {"robot": "fr", "hand": "tool", "wish": [0] * 5}, "6 elements, got 5"),
        ("jog", {"robot": "fr", "hand": "tool", "wish": [0.4, 0.4, 0, 0, 0, 0]}, "bound 0.5"),
        (
            "jog",
            {"robot": "fr", "hand": "tool", "wish": [0, 0, 0, 0, 0, 2]},
            "2 rad/s is too fast for a hand",
        ),
        ("jog", {"robot": "gr", "wish": [0] * 9}, "gr is not yours to move"),
        ("output", {"robot": "fr", "index": 0, "value": True}, "outputs of fr: 0, got 0"),
        ("dry_run", {"robot": "fr", "dq": [0.0]}, "6 joints, got 1"),
    ],
)
def test_a_request_of_the_wrong_shape_is_refused(driving_anna, bench, kind, fields, words):
    ack = driving_anna.send(kind, **fields)
    assert ack.outcome is REFUSED
    assert words in ack.text
    assert not [each for each in bench.driver_requests() if each.id is None]


def test_a_robot_without_a_camera_does_not_follow(bench):
    bench.states()
    desk = bench.browser()
    desk.takes("gr")
    for kind, fields in (("mode", {"mode": "follow"}), ("view_distance", {"value_m": 1.0})):
        assert "no camera" in desk.send(kind, robot="gr", **fields).text


def test_with_an_old_picture_nothing_moves(driving_anna, bench):
    bench.now_s += 0.3
    ack = driving_anna.send("jog", **JOG)
    assert ack.outcome is REFUSED
    assert "the picture is old" in ack.text


def test_a_command_to_a_held_robot_is_answered_with_reason_and_remedy(driving_anna, bench):
    bench.states(Phase.HELD, ReasonCode.TRACKING_ERROR)
    text = driving_anna.send("jog", **JOG).text
    assert "left its commanded path" in text
    assert "reset" in text


def test_a_stop_proceeds_from_asked_to_stopping_to_at_rest(driving_anna, bench):
    assert driving_anna.send("stop", id="s").outcome is ASKED
    assert driving_anna.status().stop is StopPhase.ASKED
    assert driving_anna.status().wanted_by == "desk"
    # who is driven from here rests even if the HLI does not hear of it
    assert bench.driver_requests()[-1] == driving.GiveCommand()
    bench.state(Phase.HELD, ReasonCode.OPERATOR_STOP, robot="gr")
    bench.state(Phase.ENGAGED, moved=0.01)
    assert driving_anna.status().stop is StopPhase.ASKED
    bench.state(Phase.HELD, ReasonCode.OPERATOR_STOP, moved=0.02)
    assert driving_anna.status().stop is StopPhase.STOPPING
    bench.state(Phase.HELD, ReasonCode.OPERATOR_STOP, moved=0.03)
    bench.state(Phase.HELD, ReasonCode.OPERATOR_STOP, robot="gr")
    assert driving_anna.status().stop is StopPhase.STOPPING
    bench.state(Phase.HELD, ReasonCode.OPERATOR_STOP, moved=0.03)
    assert driving_anna.status().stop is StopPhase.AT_REST
    driving_anna.hears(bench.core.answered(bench.asked("stop")[0].request, True, "", bench.now_s))
    assert [ack.outcome for ack in driving_anna.acks("s")] == [ASKED, DONE]
    bench.states(Phase.READY)
    assert driving_anna.status().stop is StopPhase.NONE


def test_a_stop_without_hli_stays_asked_and_unconfirmed(driving_anna, bench):
    driving_anna.send("stop", id="s")
    driving_anna.hears(bench.core.answered(bench.asked("stop")[0].request, False, "no answer", bench.now_s))
    assert driving_anna.acks("s")[-1].outcome is REFUSED
    assert driving_anna.status().stop is StopPhase.ASKED
    bench.now_s += 1.0  # states come no more: it is not known to rest
    assert driving_anna.status().stop is StopPhase.ASKED
    assert any("not confirmed" in text for text in driving_anna.events("stop"))


def test_robots_held_at_rest_by_another_cause_confirm_a_requested_stop(driving_anna, bench):
    driving_anna.send("stop")
    bench.states(Phase.HELD, ReasonCode.KRC_LOST)
    bench.state(Phase.HELD, ReasonCode.KRC_LOST, moved=0.01)
    assert driving_anna.status().stop is StopPhase.ASKED, "it moves still"
    bench.states(Phase.HELD, ReasonCode.KRC_LOST)
    assert driving_anna.status().stop is StopPhase.STOPPING
    assert driving_anna.status().stop is StopPhase.AT_REST


def test_silent_robots_are_not_reported_at_rest(driving_anna, bench):
    driving_anna.send("stop")
    bench.core.answered(bench.asked("stop")[0].request, True, "", bench.now_s)
    assert driving_anna.status().stop is StopPhase.STOPPING
    bench.now_s += 1.0
    assert driving_anna.status().stop is StopPhase.STOPPING


def test_a_stop_from_elsewhere_is_shown(driving_anna, bench):
    bench.states(Phase.HELD, ReasonCode.OPERATOR_STOP)
    driving_anna.status()
    assert driving_anna.status().stop is StopPhase.AT_REST
    assert driving_anna.status().wanted_by is None


def test_a_lost_controller_is_not_shown_as_a_stop(driving_anna, bench):
    bench.states(Phase.HELD, ReasonCode.CONTROLLER_LOST)
    assert driving_anna.status().stop is StopPhase.NONE


def test_answers_of_the_hli_reach_their_client(bench):
    desk, tower = bench.browser("desk"), bench.browser("tower")
    desk.send("reset", id="r", robot="fr")
    before = len(tower.got)
    refused = bench.core.answered(
        bench.asked("reset")[0].request, False, "cause_stands: it stands", bench.now_s
    )
    desk.hears(refused)
    tower.hears(refused)
    assert desk.acks("r")[-1].text == "cause_stands: it stands"
    assert len(tower.got) == before


def test_a_dry_run_is_answered_with_its_verdict_in_words(bench):
    desk = bench.browser()
    desk.send("dry_run", id="d", robot="fr", dq=[0.1, 0, 0, 0, 0, 0])
    (asked,) = bench.asked("dry_run")
    assert (asked.robot, asked.dq) == ("fr", (0.1, 0, 0, 0, 0, 0))
    near = Reason(code=ReasonCode.POSITION_LIMIT, what="a1", value=3.2, bound=math.pi)
    verdict = Verdict(robot="fr", cycle=1, seq=0, outcome=Outcome.SCALED, scale=0.5, reasons=(near,))
    desk.hears(bench.core.answered(asked.request, True, "", bench.now_s, verdict))
    ack = desk.acks("d")[-1]
    assert (ack.outcome, ack.verdict, ack.scale) == (DONE, Outcome.SCALED, 0.5)
    assert ack.text == "scaled to 50%: a1 at its position limit, 180.0°"


def test_the_answer_to_a_closed_connection_is_dropped(bench):
    desk = bench.browser()
    desk.send("reset", robot="fr")
    bench.core.disconnect(desk.client, bench.now_s)
    assert bench.core.answered(bench.asked("reset")[0].request, True, "", bench.now_s) == []


def test_more_clients_than_can_be_served_are_turned_away(bench):
    for number in range(32):
        bench.browser(f"b{number}")
    assert bench.core.connect("one more", True, bench.now_s) == (None, [])
    assert bench.core.counters["clients_refused"] == 1


def test_a_status_names_the_target_and_the_sight_of_a_camera(bench):
    bench.states()
    desk = bench.browser()
    bench.state(target=ViewTarget(leader="gr", aim_offset_m=(0.0, 0.0, 0.04)), sight=Sight.HIDDEN)
    told = desk.status().robots["fr"]
    assert (told.looks_at, told.sight) == ("gr:0,0,0.04", Sight.HIDDEN)
    bench.state()
    told = desk.status().robots["fr"]
    assert (told.looks_at, told.sight) == ("", None)


def test_a_status_is_sent_when_it_changes_and_once_a_second(bench):
    bench.states()
    desk = bench.browser()
    desk.status()
    count = len(desk.got)
    bench.states()
    desk.hears(bench.tick(0.2))
    assert len(desk.got) == count
    bench.core.board.heard({"fr": "leader", "gr": None}, bench.now_s)
    assert desk.status().robots["fr"].lease.holder == "leader"
    bench.states()
    count = len(desk.got)
    desk.hears(bench.tick(1.0))
    assert len(desk.got) == count + 1


def test_a_silent_hli_is_reported_and_the_old_view_is_marked(bench):
    bench.states()
    desk = bench.browser()
    bench.core.board.heard({}, bench.now_s)
    assert desk.status().hli
    bench.core.board.silent("no answer", bench.now_s)
    status = desk.status(1.0)
    assert not status.hli
    assert status.text == "no answer"
    assert "old" in status.robots["fr"].text
    bench.core.board.heard({}, bench.now_s)
    bench.states()
    assert desk.status().robots["fr"].text == "ready"
    assert desk.events("link") == ["the HLI answers", "the HLI is silent: no answer", "the HLI answers"]


def test_a_limiting_factor_is_shown_in_words_and_repeated_refusals_in_one_line(bench):
    bench.states()
    desk = bench.browser()
    near = Reason(code=ReasonCode.CLEARANCE, what="gr/link_3 structure/tank_1", value=0.052, bound=0.05)
    for _ in range(100):
        bench.verdict(Outcome.HELD, (near,), robot="gr")
    bound = desk.status().robots["gr"].bound
    assert bound.text == "held: gr/link_3 5.2 cm from structure/tank_1, 5.0 cm are kept"
    assert bound.bodies == ("gr/link_3", "structure/tank_1")
    assert len(desk.events("verdict")) == 1
    desk.status(2.5)
    assert [message.count for message in desk.got if getattr(message, "kind", "") == "verdict"] == [1, 99]


def test_a_message_with_mismatching_states_is_ignored(bench):
    bench.states()
    state = bench.core.robots["fr"].feed.state
    bench.core.picture.take_state(state.model_copy(update={"q": (0.0,)}), bench.now_s)
    bench.core.picture.take_state(state.model_copy(update={"robot": "zz"}), bench.now_s)
    assert bench.core.robots["fr"].feed.state is state


def test_every_type_of_command_has_an_expiry_but_ping_and_stop(bench):
    desk = bench.browser()
    desk.raw(json.dumps({"type": "nothing", "id": "1", "sent_ms": 0}))
    kinds = (
        desk.got[-1].text.partition("expected tags: ")[2].partition(", got")[0].replace("'", "").split(", ")
    )
    assert set(kinds) == {*EXPIRY_S, "ping", "stop"}


def test_a_command_that_waited_nine_seconds_expires_but_a_stop_does_not(driving_anna, bench):
    bench.now_s += 9.0
    bench.states()
    wishes = len(bench.driver_requests())
    late = {
        "jog": JOG,
        "mode": {"robot": "fr", "mode": "coupled"},
        "lease": {"robot": "gr", "action": "take"},
        "reset": {"robot": "fr"},
        "dry_run": {"robot": "fr", "dq": [0] * 6},
        "reach_joints": {"robot": "fr", "q": [0] * 6},
    }
    for kind, fields in late.items():
        assert driving_anna.send(kind, late_s=9.0, **fields).outcome is EXPIRED, kind
    assert len(bench.driver_requests()) == wishes
    assert driving_anna.send("stop", late_s=9.0).outcome is ASKED
    assert driving_anna.send("jog", **JOG).outcome is DONE
