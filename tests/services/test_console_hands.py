"""Hands of which several hold an object, and a master that leads one: what may be asked; the bad case first."""

import pytest
from console_bench import ConsoleBench

from deltaq_cell.load import load_cell
from deltaq_protocol import driving
from deltaq_services.console.messages import AckOutcome

REFUSED, ASKED, DONE = AckOutcome.REFUSED, AckOutcome.ASKED, AckOutcome.DONE
DAWM = load_cell("dawm")
COUPLED = driving.DrivingMode.COUPLED
TWIST = [0.1, 0, 0, 0, 0, 0]
HOLD = {"mode": "coupled", "grip": "object"}


def sat_at(robot, cell):
    bench = ConsoleBench(**cell)
    bench.states()
    desk = bench.browser("desk")
    desk.takes(robot)
    return bench, desk


@pytest.fixture
def dawm():
    """A bench and a browser that drives a robot with two hands."""
    return sat_at("dawm", {"cell": DAWM})


@pytest.fixture
def lab():
    """A bench and a browser that drives a robot with one hand."""
    return sat_at("fr", {})


def reports(bench, robot="dawm", **fields):
    report = driving.DriverReport(stage=driving.DriverStage.LEASED, mode=COUPLED, **fields)
    bench.core.driver_said(robot, report, bench.now_s)


def refused(bench, desk, kind, **fields):
    """What is said of a command that is refused, counted, and reaches no driver."""
    robot = fields["robot"]
    before, counted = len(bench.driver_requests(robot)), bench.core.counters.copy()
    ack = desk.send(kind, **fields)
    assert ack.outcome is REFUSED
    assert len(bench.driver_requests(robot)) == before
    more = bench.core.counters - counted
    assert more["refused"] + more["malformed"] == 1
    return ack.text


@pytest.mark.parametrize(
    ("kind", "fields", "words"),
    [
        ("mode", HOLD, "grip: fr has one hand"),
        ("mode", {"mode": "coupled", "grip": "tight"}, "grip: "),
        ("jog", {"hand": "left", "wish": TWIST}, "hand: fr has no hand 'left'; it has tool"),
        ("jog", {"led": True}, "led: no master was chosen for fr; it may be gr"),
        ("choose_master", {"master": "fr"}, "master: 'fr' cannot lead fr; it may be gr"),
        ("choose_master", {"master": "xx"}, "master: 'xx' cannot lead fr; it may be gr"),
        ("choose_master", {"master": "gr", "scale": float("nan")}, "scale: "),
        ("choose_master", {"master": "gr", "scale": float("inf")}, "scale: "),
        ("choose_master", {"master": "gr", "scale": 0.0}, "bound 0.01"),
        ("choose_master", {"master": "gr", "scale": 9.0}, "bound 5"),
        ("choose_master", {"master": "g" * 65}, "master: "),
    ],
)
def test_bad_commands_for_two_hands_are_refused_and_counted(lab, kind, fields, words):
    bench, desk = lab
    assert words in refused(bench, desk, kind, robot="fr", **fields)
    assert desk.send("jog", robot="fr", hand="tool", wish=TWIST).outcome is DONE


@pytest.mark.parametrize(
    ("kind", "fields", "words"),
    [
        ("jog", {"hand": "third", "wish": TWIST}, "hand: dawm has no hand 'third'; it has left, right"),
        ("jog", {"hand": "*", "wish": [9.0, 0, 0, 0, 0, 0]}, "bound 0.5"),
        ("choose_master", {"master": "dawm"}, "no robot: there is no other in the cell"),
        ("mode", {"mode": "coupled", "grip": 1}, "grip: "),
    ],
)
def test_a_robot_with_two_hands_refuses_single_hand_commands(dawm, kind, fields, words):
    bench, desk = dawm
    assert words in refused(bench, desk, kind, robot="dawm", **fields)


POSE = {"hand": "left", "position_m": [1.0, 0.2, 1.1], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("mode", HOLD),
        ("choose_master", {}),
        ("jog", {"led": True}),
        ("reach", POSE),
        ("advise", {"action": "ask"}),
    ],
)
def test_only_the_holder_grips_leads_plans_or_asks(dawm, kind, fields):
    bench, _ = dawm
    assert "desk has it" in refused(bench, bench.browser("tower"), kind, robot="dawm", **fields)
    assert "observer" in refused(bench, bench.browser("eve", operator=False), kind, robot="dawm", **fields)


def test_a_hand_does_not_leave_a_held_object(dawm):
    bench, desk = dawm
    reports(bench, grip="object")
    words = refused(bench, desk, "jog", robot="dawm", hand="left", wish=TWIST)
    assert "the hands hold an object" in words
    assert desk.send("jog", robot="dawm", hand="*", wish=TWIST).outcome is DONE
    assert bench.driver_requests("dawm")[-1].command == driving.OperatorCommand({"x": 0.1})


def test_refusals_of_the_driver_are_reported_and_counted(dawm):
    bench, desk = dawm
    assert desk.send("mode", id="m", robot="dawm", mode="joint", grip="object").outcome is ASKED
    desk.hears(bench.driver_answers("dawm", done=False, text="mode joint would part hands"))
    assert (desk.acks("m")[-1].outcome, desk.acks("m")[-1].text) == (REFUSED, "mode joint would part hands")
    assert bench.core.counters["refused_by_driver"] == 1


def test_a_grip_reaches_the_driver_and_the_grasp_is_shown(dawm):
    bench, desk = dawm
    assert desk.send("mode", robot="dawm", **HOLD).outcome is ASKED
    assert bench.driver_requests("dawm")[-1].command.grip == "object"
    assert desk.send("mode", robot="dawm", mode="decoupled").outcome is ASKED
    assert bench.driver_requests("dawm")[-1].command.grip is None, "who says nothing lets nothing go"
    off = driving.HandsOff(distance_m=0.0004, angle_rad=0.001)
    assert desk.status().robots["dawm"].goes_through == 1.0, "nothing was told"
    reports(bench, grip="object", hands_off=off, goes_through=0.3)
    told = desk.status().robots["dawm"]
    assert (told.grip, told.hands_off, told.goes_through) == ("object", off, 0.3)


def test_one_of_several_hands_is_jogged_by_its_name(dawm):
    bench, desk = dawm
    for hand, axis in (("left", "left.x"), ("right", "right.x"), ("*", "x")):
        assert desk.send("jog", robot="dawm", hand=hand, wish=TWIST).outcome is DONE
        assert bench.driver_requests("dawm")[-1].command == driving.OperatorCommand({axis: 0.1})


def test_a_master_is_chosen_coupled_while_held_and_shown(lab):
    bench, desk = lab
    assert desk.send("choose_master", robot="fr", master="gr", scale=0.5).outcome is ASKED
    asked = bench.driver_requests("fr")[-1]
    assert (asked.master, asked.scale) == ("gr", 0.5)
    reports(bench, "fr", master="gr", master_scale=0.5)
    told = desk.status().robots["fr"]
    assert (told.master, told.master_scale) == ("gr", 0.5)
    assert "wish" in refused(bench, desk, "jog", robot="fr", led=True, wish=[0.1] * 6)
    assert desk.send("jog", robot="fr", led=True, hand="tool").outcome is DONE
    assert bench.driver_requests("fr")[-1].command == driving.OperatorCommand(led="")
