"""The way to a pose of a hand, and how far it is clear; the bad case first."""

import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.operated.reach import STEP, ReachPlanner

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
def test_a_pose_out_of_reach_is_told(name):
    with pytest.raises(ControllerError, match="out of reach"):
        plan(name, (9.0, 0.0, 0.0))


def test_a_hand_that_is_not_there_and_a_turn_that_is_none_are_told():
    with pytest.raises(ControllerError, match="has no hand 'left'; it has tool"):
        ReachPlanner(LAB, "fr").plan(HOMES["fr"], {}, "left", (1.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))
    with pytest.raises(ControllerError, match="not a rotation"):
        ReachPlanner(LAB, "fr").plan(HOMES["fr"], {}, "", (1.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0))


def test_a_way_into_a_body_is_clear_only_up_to_it():
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
def test_the_way_ends_with_the_hand_at_the_pose(name, move_m):
    robot = LAB.robots[name]
    way = plan(name, move_m).way
    expected = robot.forward(robot.home)
    expected[:3, 3] += move_m
    np.testing.assert_allclose(robot.forward(np.array(way.q)), expected, atol=1e-4)
    assert (np.array(way.q) >= robot.lower).all()
    assert (np.array(way.q) <= robot.upper).all()
    np.testing.assert_allclose(way.points[0], robot.home, atol=1e-5)
    assert np.abs(way.first).max() > 0.0


def test_one_hand_of_two_is_brought_there_and_the_other_stays():
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
