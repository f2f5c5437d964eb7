"""Ways that are offered: options of the advisor and the way to a pose; what may be asked, and who is told."""

import pytest
from console_bench import ConsoleBench

from deltaq_protocol import driving
from deltaq_services.console.messages import AckOutcome, WaysView

REFUSED, ASKED = AckOutcome.REFUSED, AckOutcome.ASKED
POSE = {"robot": "fr", "hand": "tool", "position_m": [1.0, 0.2, 1.1], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
WAY = driving.Way(rank=1, q=(0.0,) * 6, points=((0.0,) * 6, (0.1,) * 6), clear=0.4, text="clear for 40 %")


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


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"hand": "left"}, "hand"),
        ({"position_m": [1.0, 2.0]}, "position_m.2"),
        ({"position_m": [1.0, 2.0, 1e9]}, "position_m.2"),
        ({"quaternion_wxyz": [1.0, 0.0, 0.0, "x"]}, "quaternion_wxyz.3"),
        ({"robot": "xx"}, "robot"),
    ],
)
def test_an_invalid_pose_is_refused_with_its_field(bench, desk, change, named):
    before = len(bench.driver_requests())
    ack = desk.send("reach", **{**POSE, **change})
    assert ack.outcome is REFUSED
    assert ack.text.startswith(f"{named}:")
    assert len(bench.driver_requests()) == before


def test_a_pose_reaches_the_driver_and_a_missing_path_is_explained(bench, desk):
    assert desk.send("reach", id="p", **POSE).outcome is ASKED
    reach = bench.driver_requests()[-1]
    assert (reach.hand, reach.position_m) == ("", (1.0, 0.2, 1.1))
    desk.hears(bench.driver_answers(done=False, text="out of reach"))
    assert (desk.acks("p")[-1].outcome, desk.acks("p")[-1].text) == (REFUSED, "out of reach")


def test_the_advisor_is_asked_again_and_cancelled(bench, desk):
    for action in ("ask", "cancel"):
        assert desk.send("advise", robot="fr", action=action).outcome is ASKED
        assert bench.driver_requests()[-1].action == action
    assert desk.send("advise", robot="fr", action="ask", trade_off=("travel", "torque")).outcome is ASKED
    assert bench.driver_requests()[-1].trade_off == ("travel", "torque")
    assert not bench.driver_requests()[-1].hands_may_leave
    assert desk.send("advise", robot="fr", action="ask", hands_may_leave=True).outcome is ASKED
    assert bench.driver_requests()[-1].hands_may_leave


def test_paths_are_sent_to_all_browsers_and_to_later_ones(bench, desk):
    eve = bench.browser("eve", operator=False)
    said = driving.DriverWays(mode=driving.DrivingMode.POSE, ways=(WAY,))
    outputs = bench.done(bench.core.driver_said("fr", said, bench.now_s))
    expected = WaysView(robot="fr", mode=driving.DrivingMode.POSE, ways=(WAY,))
    late = bench.browser("late")
    for browser in (desk, eve):
        browser.hears(outputs)
    for browser in (desk, eve, late):
        assert [message for message in browser.got if isinstance(message, WaysView)] == [expected]
    bench.core.driver_ended("fr", "signal 9", bench.now_s)
    assert not [message for message in bench.browser("later").got if isinstance(message, WaysView)]


def test_the_status_has_the_progress_of_a_search(bench, desk):
    search = driving.Search(doing="searching", done=0.5, is_busy=True, trials=100)
    report = driving.DriverReport(
        stage=driving.DriverStage.LEASED, mode=driving.DrivingMode.ADVISOR, search=search
    )
    bench.core.driver_said("fr", report, bench.now_s)
    assert desk.status().robots["fr"].search == search
    assert desk.status().robots["gr"].search is None


def test_a_configuration_and_a_step_reach_the_driver(bench, desk):
    q = list(bench.cell.robots["fr"].home)
    assert desk.send("reach_joints", robot="fr", q=q).outcome is ASKED
    assert bench.driver_requests()[-1].q == tuple(q)
    bench.states()
    assert desk.send("jog", robot="fr", wish=[0, 0, 0, 0, 0, 0.03], cycles=42).outcome is AckOutcome.DONE
    step = bench.driver_requests()[-1]
    assert (step.command.rates, step.cycles) == ({"a6": 0.03}, 42)
    ack = desk.send("jog", robot="fr", wish=[0, 0, 0, 0, 0, 0.03], cycles=1001)
    assert ack.text == "cycles: should be less than or equal to 1000, got 1001; bound 1000"


def test_a_routine_is_asked_of_the_driver_and_its_progress_is_shown(bench, desk):
    ack = desk.send("routine", robot="fr", action="turn", routine="turn")
    assert ack.text.startswith("action: should be 'plan', 'run', 'pause', 'go_on' or 'abort', got 'turn'")
    assert desk.send("routine", robot="fr", action="run", routine="../turn").outcome is AckOutcome.REFUSED
    asked = desk.send("routine", robot="fr", action="run", routine="turn", equipment="valve_1", first=3)
    assert asked.outcome is ASKED
    request = bench.driver_requests()[-1]
    assert (request.routine, request.equipment, request.first) == ("turn", "valve_1", 3)
    progress = driving.RoutineProgress(
        routine="turn", equipment="valve_1", step=3, steps=13, text="io gripper on"
    )
    report = driving.DriverReport(
        stage=driving.DriverStage.LEASED,
        mode=driving.DrivingMode.JOINT,
        routine=progress,
        routines={"valve": ("turn",)},
    )
    bench.core.driver_said("fr", report, bench.now_s)
    robot = desk.status().robots["fr"]
    assert (robot.routine, robot.routines) == (progress, {"valve": ("turn",)})
    planned = driving.DriverWays(mode=driving.DrivingMode.JOINT, routine="turn", equipment="valve_1")
    (told, *_) = bench.core.driver_said("fr", planned, bench.now_s)
    assert (told.message.robot, told.message.equipment) == ("fr", "valve_1")
    assert bench.core.robots["fr"].ways is None, (
        "it is not offered, and a page that comes later does not see it"
    )
