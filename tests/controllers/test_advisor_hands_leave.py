"""Advisor mode where the hands may leave their place on the way to an option, and come back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from advising import advised, advisor_of, cell_of
from driving import PlainDrive, model
from test_advisor_mode import go_to

from deltaq_controllers.advisor.advisor import Option, Progress
from deltaq_controllers.advisor.session import AdvisorSession, Answered, SynchronousAdvisor, near_home
from deltaq_controllers.modes.advisor import tracker_of
from deltaq_controllers.modes.interface import Limit
from deltaq_controllers.modes.motion import Grip, ModeName, OperatorCommand

IN_PLACE_M = 1e-3
NEIGHBOURS_RAD = 0.1
"""Configurations of a way that are further apart leap."""


def off_m(run: PlainDrive) -> float:
    """How far the hand is from where it was at home [m]."""
    robot = run.robot
    return float(np.linalg.norm((robot.forward(run.now) - robot.forward(robot.home))[:3, 3]))


@pytest.mark.nightly
def test_from_a_way_on_which_the_hand_left_its_place_another_option_has_it_in_place_again() -> None:
    run = PlainDrive("gr", ModeName.JOINT)
    advisor = SynchronousAdvisor(cell_of("gr"), "gr", options=12, effort=0.3)
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


@pytest.mark.long
def test_the_way_from_where_a_hand_has_left_its_place_begins_there_and_need_not_lead_back() -> None:
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


def test_hands_that_hold_an_object_do_not_leave_their_place_for_an_option() -> None:
    robot = model("dawm")
    tracker = tracker_of(robot)
    end = robot.home + np.where([name == "left_1" for name in robot.joint_names], 0.2, 0.0)
    moved = replace(
        near_home(tracker), q=end, path=np.array([robot.home, end]), hands_move=True, hands_leave=True
    )
    run = PlainDrive("dawm", ModeName.JOINT)
    run.teleoperator = advised(robot, advisor=Answered(tracker, Progress("", 1.0, 0.0, 0, (moved,))))
    run.step(OperatorCommand(grip=Grip.OBJECT))
    run.drive(0.3)
    go_to(run, 1, 100)
    np.testing.assert_array_equal(run.now, robot.home)
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert limitation.limit is Limit.NO_WAY
    assert "would part hands that hold an object" in limitation.text
    run.step(OperatorCommand(grip=Grip.FREE))
    go_to(run, 1)
    assert run.teleoperator.arrived_at == 1
