"""An operated robot whose hands hold an object, or whose hand a master leads; the bad case first."""

import numpy as np
import pytest
from driving import CYCLE_S, PlainDrive, model
from test_operated import Bench

from deltaq_controllers.interface import ControllerError, RobotView
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.motion import ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operated.wishes import LedByWishes
from deltaq_protocol.driving import DriverStage, DrivingMode

COUPLED, JOINT = DrivingMode.COUPLED, DrivingMode.JOINT
TURN = (0.0, 0.0, 0.02, 0.0, 0.0, 0.3)
KEPT_M = 5e-6


def two_hands():
    bench = Bench(teleoperator=Teleoperator(model("dawm"), CYCLE_S, ModeName.COUPLED))
    bench.cycles(2)
    return bench


def holding():
    bench = two_hands()
    bench.pilot.change_mode(COUPLED, "world", "object")
    bench.cycles(20)
    return bench


def report(bench):
    return bench.pilot.report(DriverStage.LEASED)


def between(bench):
    hands = Hands(bench.robot)
    hands.place(bench.q)
    return hands.rotations[0].T @ (hands.positions[1] - hands.positions[0])


def wishes_on(bench, cycles, **wish):
    for _ in range(0, cycles, 10):
        bench.wishes(**wish)
        bench.cycles(10)


# --- an object between two hands ---------------------------------------------------------------------------------


def test_a_robot_with_one_hand_holds_no_object_and_stays_in_its_mode():
    bench = Bench()
    for mode in (COUPLED, JOINT, DrivingMode.POSE, DrivingMode.FOLLOW):
        with pytest.raises(ControllerError, match="robot fr has one hand"):
            bench.pilot.change_mode(mode, "tool", "object")
    assert (report(bench).mode, report(bench).frame, report(bench).grip) == (JOINT, "world", "free")


@pytest.mark.parametrize("mode", [JOINT, DrivingMode.POSE, DrivingMode.FOLLOW])
@pytest.mark.parametrize("grip", [None, "object"])
def test_a_mode_that_would_part_the_hands_is_refused_and_the_object_stays_held(mode, grip):
    bench = holding()
    with pytest.raises(ControllerError, match=f"mode {mode.value} .*would part.*grip free first"):
        bench.pilot.change_mode(mode, "tool", grip)
    told = report(bench)
    assert (told.mode, told.frame, told.grip) == (COUPLED, "world", "object")
    assert told.hands_off is not None


@pytest.mark.parametrize(
    ("wish", "told"),
    [
        ({"hand": "left", "twist": TURN}, "moves one hand alone, and the hands hold an object"),
        ({"hand": "third", "twist": TURN}, "'third.z' is unknown"),
        ({"hand": "left", "led": True}, "no master was chosen"),
    ],
)
def test_a_wish_for_one_hand_or_for_none_moves_nothing(wish, told):
    bench = holding()
    with pytest.raises(ControllerError, match=told):
        bench.wishes(**wish)
    assert bench.cycles(20) == [None] * 20


def test_an_object_is_taken_at_rest_moved_as_one_and_let_go():
    bench = two_hands()
    apart = between(bench)
    wishes_on(bench, 10, twist=(0.05, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.pilot.change_mode(COUPLED, "world", "object")
    assert report(bench).hands_off is None, "it is taken at rest"
    bench.cycles(60)
    assert report(bench).hands_off.distance_m == 0.0
    wishes_on(bench, 60, twist=TURN)
    bench.cycles(60)
    assert between(bench) == pytest.approx(apart, abs=KEPT_M)
    assert (report(bench).grip, report(bench).hands_off.distance_m) == ("object", 0.0)
    bench.pilot.change_mode(JOINT, "world", "free")
    bench.cycles(30)
    assert (report(bench).grip, report(bench).hands_off) == ("free", None)


def test_who_says_nothing_of_the_grip_lets_nothing_go():
    bench = holding()
    bench.pilot.change_mode(DrivingMode.DECOUPLED, "tool")
    bench.cycles(30)
    assert report(bench).grip == "object"
    assert report(bench).hands_off is not None


@pytest.mark.parametrize("between_them", ["held", "begin"])
def test_hands_that_were_moved_by_others_are_not_drawn_together_again(between_them):
    bench = holding()
    getattr(bench.pilot, between_them)()
    bench.q = bench.q + np.where([name == "left_1" for name in bench.robot.joint_names], 0.2, 0.0)
    moved = bench.q.copy()
    bench.cycles(40)
    assert bench.q == pytest.approx(moved, abs=1e-12)
    assert report(bench).hands_off.distance_m == 0.0
    apart = between(bench)
    wishes_on(bench, 40, twist=TURN)
    assert between(bench) == pytest.approx(apart, abs=KEPT_M)


# --- a master ----------------------------------------------------------------------------------------------------


class Led:
    """`gr` operated, and `fr` as its master, which somebody else drives."""

    def __init__(self, mode=ModeName.COUPLED):
        self.leader = PlainDrive("fr", ModeName.COUPLED)
        self.bench = Bench(teleoperator=Teleoperator(model("gr"), CYCLE_S, mode), make_led=self._led)
        self.is_seen, self._cycle = True, 0
        self.bench.cycles(2)

    def _led(self, name, scale):
        return LedByWishes(self.bench.pilot._teleoperator, model(name), self._look, scale)

    def _look(self):
        self._cycle += self.is_seen
        leader, q = self.leader.now, self.bench.q
        return RobotView(self._cycle, self._cycle * CYCLE_S, leader, leader), RobotView(1, 0.0, q, q)

    def drive(self, cycles, wish=None, **rates):
        """The master is driven by somebody while this wish is held."""
        for cycle in range(cycles):
            if wish is not None and not cycle % 10:
                self.bench.wishes(**wish)
            self.leader.step(OperatorCommand(rates))
            self.bench.cycles(1)

    def hand(self):
        return self.bench.robot.forward(self.bench.q)[:3, 3]


HELD = {"led": True}


def test_a_robot_that_would_lead_itself_is_no_master_and_the_one_before_stays():
    led = Led()
    led.bench.pilot.wishes.choose_master("fr", 0.5)
    with pytest.raises(ControllerError, match="master gr: a robot cannot lead itself"):
        led.bench.pilot.wishes.choose_master("gr", 1.0)
    assert (report(led.bench).master, report(led.bench).master_scale) == ("fr", 0.5)


@pytest.mark.parametrize("mode", [JOINT, DrivingMode.SELF_MOTION, DrivingMode.POSE])
def test_in_a_mode_without_hands_nothing_is_led(mode):
    led = Led()
    led.bench.pilot.wishes.choose_master("fr", 1.0)
    led.bench.pilot.change_mode(mode, "world")
    led.bench.cycles(20)
    with pytest.raises(ControllerError, match=mode.value):
        led.bench.wishes(led=True)
    assert led.bench.cycles(10)[-1] is None


@pytest.mark.long
def test_the_hand_follows_while_the_wish_lasts_and_rests_when_it_ends():
    led = Led()
    led.bench.pilot.wishes.choose_master("fr", 0.5)
    began = led.hand()
    led.drive(20)
    led.drive(50, z=0.1)
    assert led.hand() == pytest.approx(began, abs=1e-9), "it was chosen, and not coupled"
    led.drive(200, HELD, z=0.1)
    led.drive(100, HELD)
    assert led.hand() - began == pytest.approx([0.0, 0.0, 0.5 * 200 * CYCLE_S * 0.1], abs=2e-3)
    led.drive(60)
    assert "is not coupled" in report(led.bench).doing
    rested = led.hand()
    led.drive(50, z=0.1)
    assert led.hand() == pytest.approx(rested, abs=1e-9)
    led.bench.pilot.wishes.choose_master("", 1.0)
    assert report(led.bench).master == ""


def test_a_master_that_is_lost_lets_go_until_it_is_coupled_anew():
    led = Led()
    led.bench.pilot.wishes.choose_master("fr", 1.0)
    led.drive(50, HELD, z=0.1)
    led.is_seen = False
    led.drive(50, HELD, z=0.1)
    assert "is not seen" in report(led.bench).doing
    led.is_seen = True
    rested = led.hand()
    led.drive(50, HELD, z=0.1)
    assert led.hand() == pytest.approx(rested, abs=1e-9), "it is still held, and has to be let go"
    led.drive(50)
    led.drive(50, HELD, z=0.1)
    assert led.hand()[2] > rested[2] + 0.02
