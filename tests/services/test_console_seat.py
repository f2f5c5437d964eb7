"""Two operators and one robot: who has it, who asks for it, and how it changes hands."""

import pytest
from console_bench import CELL, Browser, ConsoleBench

from deltaq_protocol import driving
from deltaq_protocol.messages import ViewTarget, ViewWish
from deltaq_services.console.core import AWAY_S
from deltaq_services.console.messages import AckOutcome

REFUSED, DONE, ASKED = AckOutcome.REFUSED, AckOutcome.DONE, AckOutcome.ASKED
JOG = {"robot": "fr", "wish": [0.1, 0, 0, 0, 0, 0]}


@pytest.fixture
def bench():
    bench = ConsoleBench()
    bench.states()
    return bench


@pytest.fixture
def desk(bench):
    desk = bench.browser("desk")
    desk.takes()
    return desk


@pytest.fixture
def tower(bench):
    return bench.browser("tower")


def lease(browser, action, **fields):
    return browser.send("lease", robot="fr", action=action, **fields)


def test_a_lease_of_an_outside_holder_is_refused_with_the_text_of_the_driver(bench):
    desk = bench.browser()
    assert lease(desk, "take", id="t").outcome is ASKED
    assert desk.send("jog", **JOG).outcome is REFUSED, "not before it is granted"
    desk.hears(bench.driver_answers(done=False, text="lease_taken: scripted-leader holds it"))
    assert desk.acks("t")[-1].text == "lease_taken: scripted-leader holds it"
    assert desk.send("jog", **JOG).outcome is REFUSED
    assert not desk.status().robots["fr"].lease.mine
    assert lease(desk, "take").outcome is ASKED


def test_the_second_operator_sees_the_holder_and_cannot_move_the_robot(bench, desk, tower):
    seen = tower.status().robots["fr"].lease
    assert (seen.holder, seen.mine) == ("desk", False)
    assert "desk has fr: ask for it" in lease(tower, "take").text
    assert "desk has it" in tower.send("jog", **JOG).text
    for action in ("release", "grant", "refuse"):
        assert "not yours" in lease(tower, action).text


def test_a_robot_is_handed_over_on_a_granted_request(bench, desk, tower):
    assert lease(desk, "grant").outcome is REFUSED
    assert lease(tower, "ask").outcome is DONE
    assert desk.status().robots["fr"].lease.wanted_by == "tower"
    assert lease(desk, "grant").outcome is DONE
    # it comes to rest first, and in between nobody moves it
    assert isinstance(bench.driver_requests()[-1], driving.Release)
    assert bench.driver_requests()[-2] == driving.GiveCommand()
    for browser in (desk, tower):
        assert browser.send("jog", **JOG).outcome is REFUSED
    bench.driver_answers()
    assert bench.driver_requests()[-1].client == "tower (console)"
    bench.driver_answers()
    assert tower.status().robots["fr"].lease.mine
    assert tower.send("jog", **JOG).outcome is DONE
    assert desk.send("jog", **JOG).outcome is REFUSED


def test_a_hand_over_can_be_refused(bench, desk, tower):
    lease(tower, "ask")
    assert lease(desk, "refuse").outcome is DONE
    told = tower.status().robots["fr"].lease
    assert (told.wanted_by, told.text) == (None, "desk keeps fr")
    assert desk.send("jog", **JOG).outcome is DONE


def test_only_one_client_may_ask_at_a_time(bench, desk, tower):
    lease(tower, "ask")
    assert "tower has asked" in lease(bench.browser("cleo"), "ask").text
    assert lease(tower, "ask").outcome is DONE
    assert "is yours" in lease(desk, "ask").text


def test_a_robot_rests_and_is_released_when_its_browser_disconnects(bench, desk, tower):
    bench.done(bench.core.disconnect(desk.client, bench.now_s))
    rest, release = bench.driver_requests()[-2:]
    assert rest == driving.GiveCommand()
    assert isinstance(release, driving.Release)
    assert lease(tower, "take").outcome is REFUSED
    bench.driver_answers()
    assert lease(tower, "take").outcome is ASKED


def test_a_disconnected_client_is_not_handed_a_robot(bench, desk, tower):
    lease(tower, "ask")
    lease(desk, "grant")
    bench.done(bench.core.disconnect(tower.client, bench.now_s))
    count = len(bench.driver_requests())
    bench.driver_answers()
    assert len(bench.driver_requests()) == count
    assert desk.status().robots["fr"].lease.holder is None


def test_a_client_that_disconnects_during_acquisition_does_not_keep_the_lease(bench):
    desk = bench.browser()
    lease(desk, "take")
    take = bench.driver_requests()[-1]
    bench.done(bench.core.disconnect(desk.client, bench.now_s))
    bench.done(bench.core.driver_said("fr", driving.DriverAnswer(id=take.id, done=True), bench.now_s))
    bench.driver_answers()
    assert lease(bench.browser("tower"), "take").outcome is ASKED


def test_the_end_of_a_driver_ends_all_waiting(bench, desk):
    desk.send("mode", id="m", robot="fr", mode="decoupled")
    desk.hears(bench.core.driver_ended("fr", "signal 9", bench.now_s))
    assert "signal 9" in desk.acks("m")[-1].text
    assert desk.send("jog", **JOG).outcome is REFUSED
    assert desk.status().robots["fr"].lease.holder is None
    assert lease(desk, "take").outcome is ASKED


def test_a_lost_lease_is_reported(bench, desk):
    lost = driving.DriverReport(
        stage=driving.DriverStage.FREE, mode=driving.DrivingMode.JOINT, doing="taken by another"
    )
    bench.core.driver_said("fr", lost, bench.now_s)
    assert desk.send("jog", **JOG).outcome is REFUSED
    assert not desk.status().robots["fr"].lease.mine
    assert any("taken by another" in text for text in desk.events("lease"))


def test_an_unexpected_answer_changes_nothing(bench, desk):
    bench.core.driver_said("fr", driving.DriverAnswer(id="r999", done=False), bench.now_s)
    assert desk.send("jog", **JOG).outcome is DONE


def test_mode_and_outputs_reach_the_driver(bench):
    desk = bench.browser()
    desk.takes("fr")
    desk.takes("gr")
    desk.send("mode", id="m", robot="fr", mode="follow", frame="tool")
    desk.send("output", id="o", robot="gr", index=1, value=True)
    change = bench.driver_requests()[-1].command
    assert (change.mode, change.frame) == ("follow", "tool")
    assert bench.driver_requests("gr")[-1].command.outputs == {"tool_changer": True}
    assert desk.acks("o")[-1].outcome is ASKED
    desk.hears(bench.driver_answers("gr", done=False, text="held"))
    assert desk.acks("o")[-1].text == "held"
    desk.send("jog", robot="gr", hand="tool", wish=[0, 0, 0.1, 0, 0, 0])
    assert bench.driver_requests("gr")[-1].command.rates == {"z": 0.1}


def test_a_view_distance_reaches_the_follower_without_an_operator_session(bench):
    desk = bench.browser()
    assert desk.send("view_distance", robot="fr", value_m=1.5).outcome is ASKED
    view = bench.asked("view")[-1]
    assert (view.robot, view.view) == ("fr", ViewWish(distance_m=1.5))
    assert not bench.driver_requests()  # no process has to be started for it
    assert "not yours to move" in desk.send("mode", robot="fr", mode="follow").text


def test_a_cameras_target_is_chosen_without_an_operator_session_and_confirmed():
    robots = CELL.robots | {"aide": CELL.robots["fr"]}
    bench = ConsoleBench(cell=CELL.model_copy(update={"robots": robots}))
    bench.states()
    desk = bench.browser()
    assert desk.status().robots["fr"].targets == ()
    assert desk.send("look_at", robot="fr", targets=["aide", "gr"]).outcome is ASKED
    asked = ViewWish(targets=(ViewTarget(leader="aide"), ViewTarget(leader="gr")))
    view = bench.asked("view")[-1]
    assert (view.robot, view.view) == ("fr", asked)
    bench.state(view=asked)
    assert desk.status().robots["fr"].targets == ("aide", "gr")
    bench.state(view=ViewWish(leader="gr", distance_m=1.0))
    assert desk.status().robots["fr"].targets == ("gr",)
    bench.state(view=ViewWish(focus_m=(1.0, 0.0, 0.0)))
    assert desk.status().robots["fr"].targets == ()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"robot": "fr", "targets": ["ghost"]}, "targets: 'ghost' is not another robot; there are gr"),
        ({"robot": "fr", "targets": ["gr", "fr"]}, "targets: 'fr' is not another robot; there are gr"),
        ({"robot": "gr", "targets": ["fr"]}, "robot: gr carries no camera"),
        ({"robot": "fr", "targets": []}, "targets: "),
        ({"robot": "fr", "targets": ["gr"] * 9}, "targets: "),
        ({"robot": "fr", "targets": ["Gr!"]}, "targets.0: "),
    ],
)
def test_an_impossible_camera_target_is_refused(bench, fields, said):
    answer = bench.browser().send("look_at", **fields)
    assert answer.outcome is AckOutcome.REFUSED
    assert answer.text.startswith(said)
    assert not bench.asked("view")


def held_outside(bench, holder="deltaq drive"):
    bench.core.board.heard({"fr": holder, "gr": None}, bench.now_s)


def test_a_holder_at_this_console_is_asked_and_not_overridden(bench, desk, tower):
    assert "desk has fr: ask for it" in lease(tower, "take_over").text
    assert not any(getattr(request, "by_force", False) for request in bench.driver_requests())


def test_an_outside_holder_is_named_and_cannot_be_asked(bench, tower):
    held_outside(bench)
    seen = tower.status().robots["fr"].lease
    assert (seen.holder, seen.outside, seen.mine) == ("deltaq drive", True, False)
    assert lease(tower, "ask").outcome is REFUSED


def test_a_robot_is_taken_from_an_outside_holder_by_force_and_reported(bench, tower):
    held_outside(bench)
    assert lease(tower, "take_over", id="t").outcome is ASKED
    take = bench.driver_requests()[-1]
    assert (take.client, take.by_force) == ("tower (console)", True)
    assert tower.send("jog", **JOG).outcome is REFUSED, "not before it is granted"
    tower.hears(bench.driver_answers())
    assert tower.acks("t")[-1].outcome is DONE
    told = tower.status().robots["fr"].lease
    assert (told.mine, told.outside) == (True, False)
    assert "tower takes fr from deltaq drive" in tower.events("lease")


def test_without_the_operator_token_the_holder_keeps_the_robot_and_the_reason_is_reported(bench, tower):
    held_outside(bench)
    lease(tower, "take_over", id="t")
    tower.hears(bench.driver_answers(done=False, text="not_permitted: the operator's token is needed"))
    assert tower.acks("t")[-1].outcome is REFUSED
    assert "token" in tower.acks("t")[-1].text
    told = tower.status().robots["fr"].lease
    assert (told.holder, told.mine) == ("deltaq drive", False)


# --- a page that is loaded anew ----------------------------------------------------------------------------------


def comes(bench, session, name="Anna", operator=True):
    client, outputs = bench.core.connect(name, operator, bench.now_s, session=session)
    return Browser(bench, client, bench.done(outputs))


def goes(bench, browser):
    bench.done(bench.core.disconnect(browser.client, bench.now_s))


@pytest.fixture
def anna(bench):
    anna = comes(bench, "s1")
    anna.takes()
    return anna


@pytest.mark.parametrize(
    "other",
    [
        {"session": "s2"},
        {"session": ""},
        {"session": "s1", "name": "Bea"},
        {"session": "s1", "operator": False},
    ],
)
def test_robots_return_only_to_the_same_session_name_and_role(bench, anna, other):
    goes(bench, anna)
    stranger = comes(bench, **other)
    assert stranger.client is not anna.client
    assert not stranger.status().robots["fr"].lease.mine
    assert stranger.send("jog", **JOG).outcome is REFUSED
    bench.tick(AWAY_S + 0.1)
    assert isinstance(bench.driver_requests()[-1], driving.Release)


def test_a_reloaded_page_keeps_its_name_and_its_resting_robot(bench, anna):
    goes(bench, anna)
    assert bench.driver_requests()[-1] == driving.GiveCommand()
    watcher = comes(bench, "s2", "Bea")
    assert watcher.status(AWAY_S - 0.1).robots["fr"].lease.holder == "Anna"
    again = comes(bench, "s1")
    assert again.got[0].client == "Anna"
    assert again.status(AWAY_S).robots["fr"].lease.mine
    bench.states()
    assert again.send("jog", **JOG).outcome is DONE


def test_robots_of_a_page_that_stays_away_are_released(bench, anna):
    goes(bench, anna)
    bench.tick(AWAY_S + 0.1)
    assert isinstance(bench.driver_requests()[-1], driving.Release)
    bench.driver_answers()
    again = comes(bench, "s1")
    assert again.status().robots["fr"].lease.holder is None
    assert again.client is not anna.client


def test_a_following_robot_is_released_at_once_when_its_page_disconnects(bench, anna):
    report = driving.DriverReport(
        stage=driving.DriverStage.LEASED, mode=driving.DrivingMode.FOLLOW, doing="follows"
    )
    bench.core.driver_said("fr", report, bench.now_s)
    goes(bench, anna)
    assert isinstance(bench.driver_requests()[-1], driving.Release)


def test_a_second_tab_of_one_session_is_an_operator_of_its_own(bench, anna):
    second = comes(bench, "s1")
    assert second.client.name == "Anna 2"
    goes(bench, second)
    assert anna.status(AWAY_S + 0.1).robots["fr"].lease.mine


def test_a_page_reconnects_before_the_end_of_its_old_connection_is_seen(bench):
    client, outputs = bench.core.connect("Anna", True, bench.now_s, session="s1", page="p1")
    anna = Browser(bench, client, bench.done(outputs))
    anna.takes()
    assert bench.core.connect("Anna", True, bench.now_s, session="s1", page="p1")[0] is client
    assert bench.core.connect("Anna", True, bench.now_s, session="s1", page="p2")[0] is not client
    assert anna.status(AWAY_S + 0.1).robots["fr"].lease.mine


def test_operators_without_a_name_are_numbered_from_one(bench):
    for _ in range(3):
        nameless = comes(bench, "", "")
        assert nameless.client.name == "operator 1"
        goes(bench, nameless)


def test_a_reset_is_logged_with_its_client(bench, anna):
    anna.send("reset", robot="fr")
    anna.hears(bench.core.answered(bench.asked("reset")[-1].request, False, "cause_stands", bench.now_s))
    anna.status()
    assert "Anna could not reset it: cause_stands" in anna.events("phase")
    assert bench.asked("reset")[-1].client.startswith("console: Anna at")


def test_while_the_hli_is_silent_no_outside_holder_is_shown(bench, anna):
    bench.core.board.heard({"fr": "Anna (console)", "gr": "leader"}, bench.now_s)
    lost = driving.DriverReport(
        stage=driving.DriverStage.FREE, mode=driving.DrivingMode.JOINT, doing="the HLI is gone"
    )
    bench.core.driver_said("fr", lost, bench.now_s)
    told = anna.status().robots["fr"].lease
    assert (told.holder, told.outside) == (None, False)
    assert told.text == "Anna has lost control: the HLI is gone"
    bench.core.board.silent("no answer", bench.now_s)
    told = anna.status()
    assert told.robots["gr"].lease.holder is None
    assert "deltaq up --cell lab --only hli" in told.remedy
