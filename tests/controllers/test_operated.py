"""What an operated robot does with wishes, modes and a follower; the bad case first."""

import numpy as np
import pinocchio as pin
import pytest
from advising import advised
from pydantic import ValidationError

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.problem import AdvisorError
from deltaq_controllers.camera.in_use import CameraInUse
from deltaq_controllers.camera.outlook import Outlook
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operated.pilot import Pilot
from deltaq_controllers.operated.reach import ReachPlanner
from deltaq_protocol.driving import (
    HAND_AXES,
    REQUESTS,
    DriverStage,
    DrivingMode,
    Frame,
    GiveCommand,
    Grip,
    OperatorCommand,
    ReachJoints,
)
from deltaq_protocol.messages import ViewWish

CYCLE_S = 0.012


class Follower:
    """A camera controller that creeps along one joint."""

    desired_distance_m, evades_below_m = 1.0, 0.0

    def __init__(self, n):
        self.dq = np.zeros(n)
        self.dq[0] = 1e-4

    def increment(self, view):
        return self.dq


def follower():
    return CameraInUse({"gr": Follower(6)}, "gr", Outlook(CellModel.load("lab"), "fr"))


def no_camera():
    raise ControllerError("fr carries no camera")


def no_master(name, _scale):
    raise ControllerError(f"the cell has no robot {name!r}")


class Bench:
    """A robot that does what it is asked to, in virtual time."""

    def __init__(self, make_follower=no_camera, teleoperator=None, make_led=no_master):
        self.robot = CellModel.load("lab").robots["fr"] if teleoperator is None else teleoperator.robot
        teleoperator = teleoperator or Teleoperator(self.robot, CYCLE_S)
        self.pilot = Pilot(teleoperator, make_follower, make_led, self.planner)
        self.q, self.before, self.cycle = self.robot.home.copy(), None, 0

    def planner(self):
        return ReachPlanner(CellModel.load("lab"), self.robot.name)

    @property
    def now_s(self):
        return self.cycle * CYCLE_S

    def cycles(self, count):
        """The increments of so many cycles; None where none was asked for. Then the robot stands."""
        made = []
        for _ in range(count):
            self.cycle += 1
            is_still = self.before is not None and bool((self.before == self.q).all())
            self.before = self.q
            view = View(RobotView(self.cycle, self.now_s, self.q, self.q))
            made.append(self.pilot.increment(view, is_still, self.now_s))
            if made[-1] is not None:
                self.q = self.q + made[-1]
        return made

    def goes(self, cycles, option=1):
        """Hold the wish to go along a way."""
        for _ in range(0, cycles, 10):
            self.wishes(option=option)
            self.cycles(10)

    def wishes(self, joints=(), twist=(), hand="", **wish):
        """Wish for speeds of joints in their order, for a twist, or for something else by name."""
        axes = [f"{hand}.{axis}" if hand else axis for axis in HAND_AXES] if twist else self.robot.joint_names
        rates = {axis: rate for axis, rate in zip(axes, twist or joints, strict=False) if rate}
        self.pilot.take(OperatorCommand(rates, **wish), self.now_s)

    def changes(self, mode, frame="world", grip=None):
        """Another mode, with its axes and grip."""
        self.pilot.take(OperatorCommand(mode=mode, frame=Frame(frame), grip=grip and Grip(grip)), self.now_s)


JOG = (0.0, 0.0, 0.0, 0.0, 0.0, 0.2)


@pytest.fixture
def bench():
    return Bench()


def test_a_command_passes_the_pipe_unchanged_and_a_malformed_one_is_refused_by_its_field():
    settings = (DrivingMode.COUPLED, Frame.TOOL, 3, {"gripper": True}, Grip.OBJECT, "left")
    command = GiveCommand(id="1", command=OperatorCommand({"left.x": 0.1}, *settings))
    assert REQUESTS.validate_json(command.model_dump_json()) == command
    for wrong in ({"twist": [0.1]}, {"rates": {"x": "fast"}}, {"option": 0}, {"mode": "fly"}):
        with pytest.raises(ValidationError, match=rf"command.command.{next(iter(wrong))}"):
            REQUESTS.validate_python({"type": "command", "command": wrong})


def test_without_a_command_no_motion_is_requested(bench):
    assert bench.cycles(30)[2:] == [None] * 28


def test_a_command_moves_its_joint_until_it_is_not_renewed(bench):
    bench.cycles(2)
    bench.wishes(joints=JOG)
    moved = bench.cycles(20)
    assert max(dq[5] for dq in moved if dq is not None) == pytest.approx(0.2 * CYCLE_S)
    assert 19 * CYCLE_S < 0.25 < 25 * CYCLE_S
    assert bench.cycles(30)[-1] is None
    stands = bench.q
    bench.cycles(10)
    assert (bench.q == stands).all()


def test_the_executed_share_is_reported_while_a_limit_binds(bench):
    def goes_through():
        return bench.pilot.report(DriverStage.LEASED).goes_through

    bench.q[5] = bench.robot.upper[5] - 0.05
    bench.cycles(2)
    assert goes_through() == 1.0
    told = []
    for _ in range(20):
        bench.wishes(joints=JOG)
        bench.cycles(5)
        told.append(goes_through())
    assert told == sorted(told, reverse=True)
    assert (told[0], told[-1]) == (1.0, 0.0)
    assert all(round(10.0 * share, 9).is_integer() for share in told), "in tenths"
    assert bench.pilot.report(DriverStage.LEASED).limit
    bench.cycles(40)
    assert goes_through() == 1.0, "nothing is wished for"


@pytest.mark.parametrize(
    "wish",
    [
        {"twist": (0.1, 0, 0, 0, 0, 0)},
        {"option": 1},
        {"hand": "left", "twist": (1, 0, 0, 0, 0, 0)},
    ],
)
def test_an_unsuitable_command_is_refused_and_ends_the_previous_one(bench, wish):
    bench.cycles(2)
    bench.wishes(joints=JOG)
    bench.cycles(5)
    with pytest.raises(ControllerError):
        bench.wishes(**wish)
    assert bench.cycles(30)[-1] is None


def test_a_held_robot_does_not_resume_after_the_reset(bench):
    bench.cycles(2)
    bench.wishes(joints=JOG)
    bench.cycles(3)
    bench.pilot.held()
    assert bench.cycles(30)[-1] is None
    assert bench.q[5] - bench.robot.home[5] < 0.02


def test_a_hand_is_moved_in_a_mode_that_drives_hands(bench):
    bench.pilot.prepare(DrivingMode.DECOUPLED)
    bench.changes(DrivingMode.DECOUPLED)
    before = bench.robot.forward(bench.q)[:3, 3]
    for _ in range(6):
        bench.wishes(twist=(0.0, 0.0, 0.05, 0.0, 0.0, 0.0))
        bench.cycles(15)
    moved = bench.robot.forward(bench.q)[:3, 3] - before
    assert moved[2] > 0.02
    assert np.abs(moved[:2]).max() < 1e-3
    assert bench.pilot.report(DriverStage.LEASED).mode is DrivingMode.DECOUPLED


def test_mode_follow_needs_a_camera(bench):
    with pytest.raises(ControllerError, match="no camera"):
        bench.pilot.prepare(DrivingMode.FOLLOW)


def test_an_unprepared_mode_is_refused_with_the_reason_until_it_is_ready():
    compiled = []

    def make():
        if not compiled:
            raise ControllerError("the camera controller is being compiled")
        return follower()

    bench = Bench(make)
    for _ in range(2):
        with pytest.raises(ControllerError, match="compiled"):
            bench.pilot.prepare(DrivingMode.FOLLOW)
        with pytest.raises(ControllerError, match="compiled"):
            bench.changes(DrivingMode.FOLLOW)
    assert bench.pilot.report(DriverStage.FREE).mode is DrivingMode.JOINT
    compiled.append(True)
    bench.pilot.prepare(DrivingMode.FOLLOW)
    bench.changes(DrivingMode.FOLLOW)
    assert bench.pilot.report(DriverStage.FREE).mode is DrivingMode.FOLLOW


def test_between_a_mode_and_the_follower_the_robot_is_at_rest():
    bench = Bench(follower)
    bench.cycles(2)
    bench.wishes(joints=JOG)
    bench.cycles(10)
    bench.pilot.prepare(DrivingMode.FOLLOW)
    bench.changes(DrivingMode.FOLLOW)
    # nothing is asked for: the gate's brake ends the motion
    assert bench.cycles(1) == [None]
    followed = bench.cycles(10)
    assert followed[-1][0] == 1e-4
    with pytest.raises(ControllerError, match="another mode"):
        bench.wishes(joints=JOG)
    bench.pilot.take_view(ViewWish(distance_m=1.7))
    assert bench.pilot.report(DriverStage.LEASED).distance_m == 1.7
    bench.changes(DrivingMode.JOINT, "tool")
    assert bench.cycles(1) == [None]
    bench.wishes(joints=JOG)
    moved = [dq for dq in bench.cycles(15) if dq is not None]
    assert all(dq[0] == 0.0 for dq in moved)
    assert moved[-1][5] > 0.0
    assert bench.pilot.report(DriverStage.LEASED).frame == "tool"


def test_the_follower_starts_with_the_formerly_requested_view():
    bench = Bench(follower)
    bench.pilot.take_view(ViewWish(distance_m=1.7))
    bench.pilot.prepare(DrivingMode.FOLLOW)
    assert bench.pilot.report(DriverStage.LEASED).distance_m == 1.7


def test_a_stop_ends_the_following():
    bench = Bench(follower)
    bench.pilot.prepare(DrivingMode.FOLLOW)
    bench.changes(DrivingMode.FOLLOW)
    bench.cycles(5)
    assert bench.pilot.is_following
    bench.pilot.held()
    assert bench.cycles(5)[-1] is None
    assert bench.pilot.report(DriverStage.LEASED).mode is DrivingMode(DrivingMode.JOINT.value)


STEP_CYCLES = 42


@pytest.mark.parametrize("share", [1.0, -1.0])
def test_a_step_turns_a_joint_by_one_degree_and_moves_a_hand_by_five_millimetres(bench, share):
    duration_s = STEP_CYCLES * CYCLE_S

    def step(axis, size):
        before = bench.q
        bench.pilot.take(OperatorCommand({axis: share * size / duration_s}), bench.now_s, STEP_CYCLES)
        bench.cycles(3 * STEP_CYCLES)
        assert bench.cycles(5) == [None] * 5, "it ends by itself"
        return before

    before = step("a6", np.deg2rad(1.0))
    assert np.rad2deg(bench.q - before) == pytest.approx([0, 0, 0, 0, 0, share], abs=1e-6)
    bench.changes(DrivingMode.COUPLED)
    bench.cycles(20)
    before = step("z", 0.005)
    moved = bench.robot.forward(bench.q)[:3, 3] - bench.robot.forward(before)[:3, 3]
    assert moved == pytest.approx([0, 0, share * 0.005], abs=1e-5)


def test_a_step_ends_with_the_next_command(bench):
    bench.pilot.take(OperatorCommand({"a6": 0.2}), bench.now_s, 1000)
    bench.cycles(50)
    bench.wishes()
    bench.cycles(50)
    assert bench.cycles(5) == [None] * 5


RISE_M = 0.1


@pytest.fixture
def planned(bench):
    """A robot in mode pose, and the way that raises its hand."""
    planner = ReachPlanner(CellModel.load("lab"), "fr")
    T = bench.robot.forward(bench.robot.home)
    turn = pin.Quaternion(T[:3, :3])
    target = T[:3, 3] + (0.0, 0.0, RISE_M)
    return planner.plan(bench.robot.home, {}, "", tuple(target), (turn.w, turn.x, turn.y, turn.z))


def in_mode_pose(bench):
    bench.pilot.prepare(DrivingMode.POSE)
    bench.changes(DrivingMode.POSE)
    bench.cycles(2)


def test_in_mode_pose_nothing_moves_before_a_path_was_planned(bench):
    in_mode_pose(bench)
    for wish in ({"option": 1}, {"joints": JOG}, {"option": 2}):
        with pytest.raises(ControllerError, match="planned"):
            bench.wishes(**wish)
    assert bench.cycles(30) == [None] * 30


def test_a_path_is_offered_only_in_its_mode_and_at_rest(bench, planned):
    with pytest.raises(ControllerError, match="mode pose"):
        bench.pilot.take_reach(planned)
    in_mode_pose(bench)
    bench.pilot.take_reach(planned)
    assert bench.cycles(20) == [None] * 20, "it is offered, and not driven"
    bench.goes(30)
    with pytest.raises(ControllerError, match="moves"):
        bench.pilot.take_reach(planned)


def test_a_held_command_brings_the_hand_to_the_pose_and_a_release_stops_it_on_the_path(bench, planned):
    in_mode_pose(bench)
    bench.pilot.take_reach(planned)
    bench.goes(40)
    bench.cycles(40)
    rested = bench.q
    bench.cycles(10)
    assert (bench.q == rested).all()
    search = bench.pilot.report(DriverStage.LEASED).search
    assert 0.0 < search.driven < 1.0
    assert (search.way, search.arrived) == (1, False)
    bench.goes(400)
    raised = bench.robot.forward(bench.q)[2, 3] - bench.robot.forward(bench.robot.home)[2, 3]
    assert raised == pytest.approx(RISE_M, abs=1e-6)
    assert bench.pilot.report(DriverStage.LEASED).search.arrived


def test_a_configuration_is_reached_like_a_pose(bench):
    in_mode_pose(bench)
    target = tuple(bench.robot.home + np.array([0.0, 0.0, 0.0, 0.2, 0.0, 0.3]))
    bench.pilot.take_reach(bench.pilot.plan(ReachJoints(id="1", q=target), bench.robot.home, {}))
    (way,) = bench.pilot.ways().ways
    assert (way.clear, way.q) == (1.0, pytest.approx(target, abs=1e-5))
    bench.goes(200)
    assert bench.q == pytest.approx(np.array(target), abs=1e-9)


@pytest.mark.parametrize(
    ("q", "words"), [((0.0,) * 5, "q: fr has 6 joints, got 5"), ((9.0,) + (0.0,) * 5, "a1 at 9 .* bounds")]
)
def test_an_impossible_configuration_is_refused_with_its_bound(bench, q, words):
    in_mode_pose(bench)
    with pytest.raises(ControllerError, match=words):
        bench.pilot.plan(ReachJoints(id="1", q=q), bench.robot.home, {})


def test_a_path_is_dropped_with_its_mode(bench, planned):
    in_mode_pose(bench)
    bench.pilot.take_reach(planned)
    assert bench.pilot.ways().ways == (planned.way,)
    bench.goes(30)
    bench.changes(DrivingMode.JOINT)
    assert bench.cycles(1) == [None], "the gate's brake ends the motion"
    assert bench.pilot.ways().ways == ()
    bench.cycles(2)
    stands = bench.q
    bench.wishes(joints=JOG)
    bench.cycles(15)
    assert (bench.q[:5] == stands[:5]).all()
    assert bench.q[5] > stands[5]


def test_the_advisor_answers_only_in_its_mode(bench):
    with pytest.raises(ControllerError, match="mode advisor"):
        bench.pilot.advise(again=True)


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("travel", "beauty"), "trade_off: no criterion 'beauty'; there are travel, limits"),
        (("travel", "travel"), "trade_off: two different criteria, got 'travel' twice"),
    ],
)
def test_an_invalid_trade_off_is_refused_without_a_search(names, told):
    bench = Bench(teleoperator=advised(CellModel.load("lab").robots["gr"]))
    bench.changes(DrivingMode.ADVISOR)
    bench.cycles(20)
    ways = bench.pilot.ways()
    with pytest.raises(ControllerError, match=told):
        bench.pilot.advise(again=True, trade_off=names)
    bench.cycles(20)
    assert bench.pilot.ways() is ways


@pytest.mark.long
def test_a_non_redundant_arm_gets_options_if_its_hand_may_leave_its_pose():
    bench = Bench(teleoperator=advised(CellModel.load("lab").robots["fr"], hands_may_leave=True))
    bench.changes(DrivingMode.ADVISOR)
    bench.cycles(5)
    assert bench.pilot.report(DriverStage.LEASED).search.hands_may_leave
    assert any(way.hands_leave for way in bench.pilot.ways().ways)
    bench.pilot.advise(again=True)
    with pytest.raises(AdvisorError, match=r"'fr' is not redundant.*unless the hand may leave"):
        bench.cycles(5)
    assert not bench.pilot.report(DriverStage.LEASED).search.hands_may_leave


@pytest.mark.long
def test_options_are_offered_reached_cancelled_and_requested_again():
    gr = CellModel.load("lab").robots["gr"]
    bench = Bench(teleoperator=advised(gr))
    bench.changes(DrivingMode.ADVISOR)
    bench.cycles(20)
    ways = bench.pilot.ways()
    assert [way.rank for way in ways.ways] == [1, 2, 3]
    assert all(way.costs.keys() >= {"travel", "clearance"} for way in ways.ways)
    assert bench.pilot.ways() is ways, "told once"
    rank = next(way.rank for way in ways.ways if len(way.points) > 1 and way.points[0] != way.points[-1])
    bench.goes(60, rank)
    assert bench.pilot.report(DriverStage.LEASED).search.way == rank
    bench.pilot.advise(again=False)
    bench.cycles(60)
    assert bench.pilot.report(DriverStage.LEASED).search.way is None
    stands = bench.q
    assert bench.cycles(20) == [None] * 20
    bench.pilot.advise(again=True)
    bench.wishes()
    bench.cycles(5)
    assert bench.pilot.ways().ways[0].points[0] == pytest.approx(stands, abs=1e-4)
    assert bench.pilot.ways() is not ways
