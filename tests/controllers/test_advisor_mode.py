"""Advisor mode: options with the hands still, one chosen and driven to, taken back and gone on with at will."""

from dataclasses import replace

import numpy as np
import pytest
from advising import advised, advisor_of, cell_of
from driving import PlainDrive, StackDrive, model

from deltaq_controllers.advisor.advisor import Option, Progress
from deltaq_controllers.advisor.session import AdvisorSession, Answered, SynchronousAdvisor, near_home
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.modes.advisor import NOTHING_FOUND, tracker_of
from deltaq_controllers.modes.interface import Limit
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode, Grip, OperatorCommand
from deltaq_protocol.messages import Outcome

KEPT_M, KEPT_RAD = 1e-4, np.deg2rad(0.01)
LONGEST_CYCLES = 4000


def plain(robot: str) -> PlainDrive:
    """A robot in advisor mode that stands, its options known."""
    run = PlainDrive(robot, DrivingMode.JOINT)
    run.teleoperator = advised(run.robot)
    run.drive(0.3)
    return run


def drivable(run: PlainDrive) -> list[int]:
    options = advisor_of(run.teleoperator).options
    return [rank for rank, option in enumerate(options, start=1) if option.path is not None]


def go_to(run: PlainDrive, rank: int, cycles: int = LONGEST_CYCLES) -> None:
    for _ in range(cycles):
        run.step(OperatorCommand(option=rank))
        if run.teleoperator.arrived_at == rank:
            return


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("robot", ["gr", "dawm"])
def test_several_options_are_reached_in_turn_with_the_hands_in_place(robot: str) -> None:
    run = plain(robot)
    home = run.now
    ranks = drivable(run)
    assert len(ranks) >= 2
    for rank in ranks[:2]:
        go_to(run, rank)
        assert run.teleoperator.arrived_at == rank
        assert run.teleoperator.limitation is None
        assert run.now == pytest.approx(advisor_of(run.teleoperator).options[rank - 1].q, abs=1e-6)
        off_m, off_rad = run.driven.hand_errors(run.driven.q_cmd[::3], home)
        assert off_m < KEPT_M
        assert off_rad < KEPT_RAD
    assert run.violations == 0


@pytest.mark.long
def test_a_withdrawn_choice_stops_on_the_path_and_can_be_resumed() -> None:
    run = plain("gr")
    home = run.now
    (rank, *_) = drivable(run)
    go_to(run, rank, 150)
    assert not run.teleoperator.is_at_rest
    run.rest()
    assert run.teleoperator.is_at_rest
    assert run.teleoperator.arrived_at is None
    between = run.now
    assert np.abs(between - home).max() > 0.05
    go_to(run, rank)
    assert run.teleoperator.arrived_at == rank
    off_m, off_rad = run.driven.hand_errors(run.driven.q_cmd, home)
    assert off_m < KEPT_M
    assert off_rad < KEPT_RAD
    assert run.violations == 0


@pytest.mark.long
@pytest.mark.nightly
def test_another_option_chosen_on_the_path_is_reached_from_there() -> None:
    run = plain("gr")
    first, second, *_ = drivable(run)
    go_to(run, first, 150)
    assert not run.teleoperator.is_at_rest
    go_to(run, second)
    assert run.teleoperator.arrived_at == second
    assert run.violations == 0


@pytest.mark.long
@pytest.mark.nightly
def test_the_mode_is_switched_during_motion_without_a_jump() -> None:
    other = DrivingMode.COUPLED
    run = plain("gr")
    (rank, *_) = drivable(run)
    go_to(run, rank, 150)
    before = advisor_of(run.teleoperator).options
    axis = run.teleoperator.axes(other)[0]
    run.drive(1.5, other, **{axis: 0.1})
    assert run.teleoperator.mode is other
    assert not run.teleoperator.is_at_rest
    run.drive(1.5, DrivingMode.ADVISOR)
    assert run.teleoperator.mode is DrivingMode.ADVISOR
    assert advisor_of(run.teleoperator).options != before
    np.testing.assert_array_equal(advisor_of(run.teleoperator).options[0].start, run.now)
    assert run.violations == 0


@pytest.mark.long
def test_an_unknown_option_is_reported_and_nothing_moves() -> None:
    run = plain("gr")
    home = run.now
    go_to(run, 9, 50)
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert (limitation.limit, limitation.what) == (Limit.NO_WAY, "option 9")
    assert limitation.text == "there is no option 9; there are 3"
    assert (run.now == home).all()
    go_to(run, drivable(run)[0])
    assert run.teleoperator.limitation is None


def test_a_non_redundant_robot_has_no_advisor_mode_and_hand_axes_are_refused() -> None:
    with pytest.raises(ControllerError, match="advisor needs a redundant robot, 'fr' is not"):
        advised(model("fr"))
    with pytest.raises(ControllerError, match=r"'x' is not driven in mode advisor .* an option of its own"):
        advised(model("gr")).check(OperatorCommand({"x": 0.1}), DrivingMode.ADVISOR)
    with pytest.raises(ControllerError, match="option 1: options are for mode advisor, not coupled"):
        advised(model("gr")).check(OperatorCommand(option=1), DrivingMode.COUPLED)


class Thinking:
    """An advisor that has not answered yet."""

    trouble, is_busy = "", True
    progress: Progress | None = None

    def __init__(self) -> None:
        self.tracker = ConstraintTracker(model("gr"))
        self.given_up = False

    def ask(self, q: Array, trade_off: tuple[str, str] | None = None, hands_may_leave: bool = False) -> None:
        self.given_up = False

    def seek(self, back: Array, rank: int) -> None:
        raise AssertionError("there is no option")

    def give_up(self) -> None:
        self.given_up = True


class AtALoss(Thinking):
    """An advisor that has found nothing."""

    is_busy, progress = False, Progress("finding paths", 1.0, np.inf, 1000)


def test_if_no_configuration_holds_the_hands_the_operator_gets_a_remedy() -> None:
    run = PlainDrive("gr", DrivingMode.JOINT)
    run.teleoperator = advised(run.robot, advisor=AtALoss())
    go_to(run, 1, 50)
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert (limitation.limit, limitation.text) == (Limit.NO_WAY, NOTHING_FOUND)
    assert not run.teleoperator.awaits_advice


def test_the_robot_rests_during_the_search_and_leaving_the_mode_cancels_it() -> None:
    run, advisor = PlainDrive("gr", DrivingMode.JOINT), Thinking()
    run.teleoperator = advised(run.robot, advisor=advisor)
    home = run.now
    assert not run.teleoperator.awaits_advice
    go_to(run, 1, 50)
    assert run.teleoperator.awaits_advice
    assert advisor_of(run.teleoperator).status == "thinking"
    assert (run.now == home).all()
    run.drive(0.5, DrivingMode.JOINT, a1=0.2)
    assert not run.teleoperator.is_at_rest
    assert advisor.given_up


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(
    ("silent_cycles", "at_most_m", "at_most_deg"),
    [(0, 1e-4, 0.01), (6, 1e-4, 0.01)],
    ids=["answering every cycle", "falling silent on the way"],
)
def test_measured_hands_stay_in_place_on_the_path_to_an_option_through_the_whole_stack(
    silent_cycles: int, at_most_m: float, at_most_deg: float
) -> None:
    run = StackDrive("dawm", DrivingMode.JOINT)
    run.teleoperator = advised(run.robot)
    run.drive(0.3)
    home = run.robot.home
    option = next(
        rank for rank, one in enumerate(advisor_of(run.teleoperator).options, start=1) if one.path is not None
    )
    ways = [run.drive(1.0, option=option)]
    for _ in range(silent_cycles):
        run.stack.cycle()
    while run.teleoperator.arrived_at is None:
        assert len(ways) < 60
        ways.append(run.drive(1.0, option=option))
    off = [way.hand_errors(way.q, home) for way in ways]
    assert max(m for m, _ in off) < at_most_m
    assert np.rad2deg(max(rad for _, rad in off)) < at_most_deg
    outcomes = [verdict.outcome for way in ways for verdict in way.verdicts]
    assert set(outcomes) <= {Outcome.ADMITTED, Outcome.SCALED}
    assert outcomes.count(Outcome.ADMITTED) > 0.9 * len(outcomes)
    tracker = ConstraintTracker(run.robot)
    assert np.abs(tracker.hands(ways[-1].q_cmd[-1]) - tracker.hands(home)).max() < 1e-6


# Advisor mode where the hands may leave their place on the way to an option, and come back.


IN_PLACE_M = 1e-3
NEIGHBOURS_RAD = 0.1
"""Configurations of a way that are further apart leap."""


def off_m(run: PlainDrive) -> float:
    """How far the hand is from where it was at home [m]."""
    robot = run.robot
    return float(np.linalg.norm((robot.forward(run.now) - robot.forward(robot.home))[:3, 3]))


@pytest.mark.nightly
def test_the_next_option_brings_back_a_hand_that_left_its_pose() -> None:
    run = PlainDrive("gr", DrivingMode.JOINT)
    advisor = SynchronousAdvisor(AdvisorSession(cell_of("gr"), "gr", options=12, effort=0.3))
    run.teleoperator = advised(run.robot, advisor=advisor, hands_may_leave=True)
    run.drive(0.3)
    options = advisor_of(run.teleoperator).options
    ranks = [rank for rank, option in enumerate(options, start=1) if option.path is not None]
    leaving = next(rank for rank in ranks if options[rank - 1].hands_leave)
    keeping = next(rank for rank in ranks if not options[rank - 1].hands_leave)
    while off_m(run) < 10 * IN_PLACE_M:
        run.step(OperatorCommand(option=leaving))
    go_to(run, keeping)
    assert run.teleoperator.arrived_at == keeping
    assert off_m(run) < IN_PLACE_M
    assert run.violations == 0
    assert advisor_of(run.teleoperator).options[keeping - 1].hands_leave, (
        "it is told that they left it on this way"
    )


@pytest.mark.nightly
def test_a_path_after_a_hand_left_its_pose_begins_there_and_need_not_lead_back() -> None:
    cell = cell_of("gr")
    session = AdvisorSession(cell, "gr", options=12, effort=0.3)
    home = cell.robots["gr"].home
    others = {name: robot.home for name, robot in cell.robots.items() if name != "gr"}
    found: list[tuple[Option, ...]] = []

    def note(progress: Progress) -> bool:
        found.append(progress.options)
        return True

    session.ask(home, others, note, hands_may_leave=True)
    asked = found[-1]
    leaving = next(option for option in asked if option.path is not None and option.hands_leave)
    keeping = next(
        rank
        for rank, option in enumerate(asked, start=1)
        if option.path is not None and not option.hands_leave
    )
    assert leaving.path is not None
    back = leaving.path[: len(leaving.path) // 2][::-1]
    session.seek(back, keeping, others, note)
    way = found[-1][keeping - 1].path
    assert way is not None
    np.testing.assert_array_equal(way[0], back[0])
    assert np.abs(np.diff(way, axis=0)).max() < NEIGHBOURS_RAD
    onwards = asked[keeping - 1].path
    assert onwards is not None
    assert len(way) < len(back) + len(onwards)


def test_hands_that_hold_an_object_stay_in_place_for_every_option() -> None:
    robot = model("dawm")
    tracker = tracker_of(robot)
    end = robot.home + np.where([name == "left_1" for name in robot.joint_names], 0.2, 0.0)
    moved = replace(
        near_home(tracker), q=end, path=np.array([robot.home, end]), hands_move=True, hands_leave=True
    )
    run = PlainDrive("dawm", DrivingMode.JOINT)
    run.teleoperator = advised(robot, advisor=Answered(tracker, Progress("", 1.0, 0.0, 0, (moved,))))
    run.step(OperatorCommand(grip=Grip.OBJECT))
    run.drive(0.3)
    go_to(run, 1, 100)
    np.testing.assert_array_equal(run.now, robot.home)
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert limitation.limit is Limit.NO_WAY
    assert "would separate hands that hold an object" in limitation.text
    run.step(OperatorCommand(grip=Grip.FREE))
    go_to(run, 1)
    assert run.teleoperator.arrived_at == 1
