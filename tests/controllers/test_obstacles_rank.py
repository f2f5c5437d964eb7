"""Of two configurations that mirror each other the one that is near the structure comes second.

The arm of seven axes stands upright with its hand in the plane in which it bends, so that its elbow swings as far to
one side as to the other: joint travel, clearance from itself and everything else are the same on either. Its links
have no masses, as in many a URDF: then nothing has a load.
"""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
import seven_axes
from closed_loop import lab

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Pose
from deltaq_cell.description.bodies import Attachment, Body
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.advisor import Option, Progress, advise
from deltaq_controllers.advisor.problem import WEIGHTS, AdvisorProblem
from deltaq_controllers.criteria import Postures
from deltaq_controllers.criteria.near_bodies import PairKind
from deltaq_controllers.criteria.table import Normalised
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array
from studies.advised_starts import CELLS, starts

pytestmark = pytest.mark.long

IN_PLANE = np.deg2rad([0.0, 35.0, 0.0, -95.0, 0.0, 40.0, 0.0])
MIRRORED = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""Signs of the joints in the mirror of that plane."""
SWING_RAD = 0.4
"""Of the joint that is free."""
ELBOW = 4
"""The joint whose body comes near the structure."""
BESIDE_M = 0.23
"""From the elbow to the middle of the structure."""
ON_WRIST = {
    "link": "l5",
    "shape": {"kind": "sphere", "radius_m": 0.03},
    "pose": {"position_m": [0.179, 0.0, 0.007]},
}
"""A body of the arm in that plane that its last link is always near to."""


@cache
def tracker() -> ConstraintTracker:
    description = seven_axes.cell().robots["fr"].description
    attachments = {"on_wrist": Attachment.model_validate(ON_WRIST)}
    changes = {"base": Pose(), "camera": None, "mounted_on": (), "attachments": attachments}
    upright = description.model_copy(update=changes)
    return ConstraintTracker(RobotModel(upright, "fr", seven_axes.urdf()))


@cache
def sides() -> tuple[Array, Array]:
    """(n,) two configurations with one pose of the hand, the elbow to the left and to the right of the plane."""
    robot, free = tracker().robot, tracker().base
    one = tracker().track(IN_PLANE[None, free] + SWING_RAD, tracker().hands(IN_PLANE), IN_PLANE)[0]
    other = MIRRORED * one
    for q in (one, other):
        np.testing.assert_allclose(robot.forward(q), robot.forward(IN_PLANE), atol=1e-9)
    left, right = sorted((one, other), key=lambda q: -elbow(q)[1])
    assert elbow(left)[1] > 0.05
    return left, right


def elbow(q: Array) -> Array:
    """(3,) its origin in the world [m]."""
    model = tracker().robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.array(data.oMi[ELBOW].translation)


def problem(beside: Array | None) -> AdvisorProblem:
    """The hand in the plane, in a cell of nothing but the arm and, if asked for, a box beside a point (3,)."""
    box = {"shape": {"kind": "box", "size_m": [0.1, 0.1, 0.1]}}
    structure = {}
    if beside is not None:
        outwards = np.array([0.0, np.copysign(BESIDE_M, beside[1]), 0.0])
        pose = {"position_m": (beside + outwards).tolist()}
        structure["box"] = Body.model_validate({**box, "pose": pose})
    description = lab().description.model_copy(update={"structure": structure})
    cell = CellModel.of(description, {"fr": tracker().robot})
    return AdvisorProblem(cell, "fr", tracker().hands(IN_PLANE), tracker=tracker())


def costs(task: AdvisorProblem, names: tuple[str, ...], q: Array) -> Array:
    """(N, k) of criteria at configurations (N, n)."""
    return Normalised(task.data, dict.fromkeys(names, 1.0)).costs(Postures(task.data, q))


@pytest.mark.nightly
def test_without_a_structure_both_sides_are_equal() -> None:
    task = problem(None)
    left, right = task.energies(np.array(sides()))
    assert left == pytest.approx(right, abs=1e-6)


@pytest.mark.parametrize("near", [0, 1])
def test_a_structure_near_one_side_puts_the_other_first(near: int) -> None:
    both = np.array(sides())
    task = problem(elbow(both[near]))
    energies = task.energies(both)
    assert energies[near] > energies[1 - near] + 0.1

    others = tuple(name for name in task.weights if name != "obstacle_clearance")
    assert set(others) == set(WEIGHTS) - {"obstacle_clearance", "robot_clearance"}
    at_one, at_other = costs(task, others, both)
    np.testing.assert_allclose(at_one, at_other, atol=1e-6)

    # the arm's own pair is the nearest on both sides, so that a clearance of all pairs hardly tells them apart
    at_near = task.data.bodies.nearest(both[near])
    assert 0.0 < at_near[PairKind.SELF].room_m < at_near[PairKind.ENVIRONMENT].room_m
    assert at_near[PairKind.SELF].pair == ("fr/on_wrist", "fr/l7")
    of_all, of_obstacles = np.ptp(costs(task, ("clearance", "obstacle_clearance"), both), axis=0)
    assert of_obstacles > 5.0 * of_all


@pytest.mark.parametrize("near", [0, 1])
def test_the_advisor_prefers_configurations_away_from_the_structure(near: int) -> None:
    both = sides()
    found = advise(problem(elbow(both[near])), IN_PLANE, generator=np.random.default_rng(0), effort=0.5)
    assert found[0].path is not None
    assert np.sign(elbow(found[0].q)[1]) == np.sign(elbow(both[1 - near])[1])


# The best configuration that keeps the hands in place is an option, whatever else is found where they may leave.


COUNT = 2
"""So few options that those to which the hands leave would fill them."""


@cache
def starts_of(robot: str) -> list[Array]:
    return starts(CellModel.load(CELLS[robot]), robot, 3, seed=2024)


@cache
def asked(robot: str, number: int, hands_may_leave: bool) -> tuple[list[Option], list[Progress]]:
    cell, q = CellModel.load(CELLS[robot]), starts_of(robot)[number]
    tracker = ConstraintTracker(cell.robots[robot])
    task = AdvisorProblem(cell, robot, tracker.hands(q), None, tracker, None, hands_may_leave)
    told: list[Progress] = []
    found = advise(
        task,
        q,
        generator=np.random.default_rng(3),
        options=COUNT,
        effort=0.4,
        go_on=lambda progress: told.append(progress) is None,
    )
    return found, told


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("robot", ["gr", "dawm", "fr"])
def test_with_hands_that_may_leave_the_best_option_in_place_has_a_path(robot: str, number: int) -> None:
    found, _ = asked(robot, number, True)
    in_place = [option for option in found if not option.hands_leave]
    assert len(found) <= COUNT
    best = asked(robot, number, False)[0][0] if robot != "fr" else None  # without a joint to spare it stays
    expected = starts_of(robot)[number] if best is None else best.q
    assert any((option.q == expected).all() and option.path is not None for option in in_place)
