"""An operated robot whose hands hold an object, or whose hand a master leads; the bad case first."""

import numpy as np
import pinocchio as pin
import pytest
from driving import CYCLE_S, PlainDrive, model
from test_operated import Bench

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.interface import ControllerError, RobotView
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operated.reach import STEP, ReachPlanner
from deltaq_controllers.operator_input.master import Master
from deltaq_protocol.driving import DriverStage, DrivingMode, OperatorCommand

COUPLED, JOINT = DrivingMode.COUPLED, DrivingMode.JOINT
TURN = (0.0, 0.0, 0.02, 0.0, 0.0, 0.3)
KEPT_M = 5e-6


def two_hands():
    bench = Bench(teleoperator=Teleoperator(model("dawm"), CYCLE_S, DrivingMode.COUPLED))
    bench.cycles(2)
    return bench


def holding():
    bench = two_hands()
    bench.changes(COUPLED, grip="object")
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
            bench.changes(mode, "tool", "object")
    assert (report(bench).mode, report(bench).frame, report(bench).grip) == (JOINT, "world", "free")


@pytest.mark.parametrize(
    ("wish", "told"),
    [
        ({"hand": "left", "twist": TURN}, "moves one hand alone, and the hands hold an object"),
        ({"hand": "third", "twist": TURN}, "'third.z' is unknown"),
        ({"led": "left"}, "no master was chosen"),
    ],
)
def test_a_command_for_a_single_hand_moves_nothing_during_a_grasp(wish, told):
    bench = holding()
    with pytest.raises(ControllerError, match=told):
        bench.wishes(**wish)
    assert bench.cycles(20) == [None] * 20


def test_an_object_is_taken_at_rest_moved_as_one_body_and_released():
    bench = two_hands()
    apart = between(bench)
    wishes_on(bench, 10, twist=(0.05, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.changes(COUPLED, grip="object")
    assert report(bench).hands_off is None, "it is taken at rest"
    bench.cycles(60)
    assert report(bench).hands_off.distance_m == 0.0
    wishes_on(bench, 60, twist=TURN)
    bench.cycles(60)
    assert between(bench) == pytest.approx(apart, abs=KEPT_M)
    assert (report(bench).grip, report(bench).hands_off.distance_m) == ("object", 0.0)
    bench.changes(JOINT, grip="free")
    bench.cycles(30)
    assert (report(bench).grip, report(bench).hands_off) == ("free", None)


@pytest.mark.parametrize("between_them", ["held", "begin"])
def test_hands_moved_by_another_client_are_not_pulled_together(between_them):
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

    def __init__(self, mode=DrivingMode.COUPLED):
        self.leader = PlainDrive("fr", DrivingMode.COUPLED)
        self.bench = Bench(teleoperator=Teleoperator(model("gr"), CYCLE_S, mode), make_led=self._led)
        self.is_seen, self._cycle = True, 0
        self.bench.cycles(2)

    def _led(self, name, scale):
        return Master(self.bench.pilot._teleoperator, model(name), self._look, scale)

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


HELD = {"led": ""}


@pytest.mark.long
def test_the_hand_follows_during_a_command_and_stops_at_its_end():
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


# The way to a pose of a hand, and how far it is clear; the bad case first.


LAB = CellModel.load("lab")
DAWM = CellModel.load("dawm")
HOMES = {name: robot.home for name, robot in LAB.robots.items()}


def pose_of(robot, q, hand="tool", move_m=(0.0, 0.0, 0.0)):
    T = robot.forward(q, hand)
    turn = pin.Quaternion(T[:3, :3])
    return tuple((T[:3, 3] + move_m).tolist()), (turn.w, turn.x, turn.y, turn.z)


def plan(name, move_m, cell=LAB, hand=""):
    robot = cell.robots[name]
    place, turn = pose_of(robot, robot.home, hand or "tool", move_m)
    others = {other: model.home for other, model in cell.robots.items() if other != name}
    return ReachPlanner(CellModel.load(cell.description.cell), name).plan(
        robot.home, others, hand, place, turn
    )


@pytest.mark.parametrize("name", ["fr", "gr"])
def test_a_pose_out_of_reach_is_reported(name):
    with pytest.raises(ControllerError, match="out of reach"):
        plan(name, (9.0, 0.0, 0.0))


def test_an_unknown_hand_and_an_invalid_rotation_are_reported():
    with pytest.raises(ControllerError, match="has no hand 'left'; it has tool"):
        ReachPlanner(LAB, "fr").plan(HOMES["fr"], {}, "left", (1.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))
    with pytest.raises(ControllerError, match="not a rotation"):
        ReachPlanner(LAB, "fr").plan(HOMES["fr"], {}, "", (1.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0))


def test_a_path_into_a_body_is_clear_only_up_to_the_body():
    tank = next(body for body in LAB.structure if "tank" in body.name)
    gr = LAB.robots["gr"]
    way = plan("gr", tank.placement.translation - gr.forward(gr.home)[:3, 3]).way
    assert 0.0 < way.clear < 1.0
    assert "clear for" in way.text
    # measured by other code than that which looked for it
    exact = ExactClearance(LAB, "gr", HOMES)
    start, end = gr.home, np.array(way.q)
    pieces = int(np.ceil(np.abs(end - start).max() / STEP))
    at = round(way.clear * (pieces + 1))
    rooms = [exact.measure(start + k / pieces * (end - start)).room_m for k in (at - 1, at)]
    assert rooms[0] > 0.0 >= rooms[1] - 1e-4


@pytest.mark.parametrize(
    ("name", "move_m"), [("fr", (0.1, -0.2, 0.1)), ("gr", (0.2, 0.0, 0.1)), ("gr", (0.0, -1.2, 0.0))]
)
def test_the_path_ends_with_the_hand_at_the_pose(name, move_m):
    robot = LAB.robots[name]
    way = plan(name, move_m).way
    expected = robot.forward(robot.home)
    expected[:3, 3] += move_m
    np.testing.assert_allclose(robot.forward(np.array(way.q)), expected, atol=1e-4)
    assert (np.array(way.q) >= robot.lower).all()
    assert (np.array(way.q) <= robot.upper).all()
    np.testing.assert_allclose(way.points[0], robot.home, atol=1e-5)
    assert np.abs(way.first).max() > 0.0


def test_one_of_two_hands_reaches_the_pose_and_the_other_stays():
    robot = DAWM.robots["dawm"]
    moved, kept = robot.hands[:2]
    way = plan("dawm", (0.0, 0.0, 0.05), DAWM, moved).way
    q = np.array(way.q)
    np.testing.assert_allclose(robot.forward(q, kept), robot.forward(robot.home, kept), atol=1e-4)
    assert robot.forward(q, moved)[2, 3] - robot.forward(robot.home, moved)[2, 3] == pytest.approx(
        0.05, abs=1e-4
    )
    with pytest.raises(ControllerError, match="has no hand"):
        ReachPlanner(CellModel.load("dawm"), "dawm").plan(
            robot.home, {}, "", *pose_of(robot, robot.home, moved)
        )
