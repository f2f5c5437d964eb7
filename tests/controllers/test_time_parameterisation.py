"""Following an option's path: at what time to be where, and what comes next."""

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import Option, advise
from deltaq_controllers.advisor.exact import (
    FINE,
    FINE_SHARE,
    MARGIN_M,
    ExactClearance,
    HandsKept,
    HandsMoved,
    Space,
)
from deltaq_controllers.advisor.path_planner import PathPlanner, parted
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.advisor.time_parameterisation import Route, timed
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array

CELL = CellModel.load("dawm")
DAWM = CELL.robots["dawm"]
TRACKER = ConstraintTracker(DAWM)
CYCLE_S = CELL.description.cycle_s


@pytest.fixture(scope="module")
def option() -> Option:
    task = AdvisorProblem(CELL, "dawm", TRACKER.hands(DAWM.home), None, TRACKER)
    found = advise(task, DAWM.home, generator=np.random.default_rng(1), options=3)
    return next(option for option in found if option.path is not None)


def path_of(option: Option) -> Array:
    assert option.path is not None
    return option.path


@pytest.mark.long
def test_a_timed_path_keeps_the_joints_limits_and_begins_and_ends_at_rest(option: Option) -> None:
    setpoints = timed(path_of(option), TRACKER, CYCLE_S)
    dq = np.diff(setpoints, axis=0, prepend=setpoints[:1], append=setpoints[-1:])
    assert np.all(np.abs(dq) <= 0.7 * DAWM.max_velocity * CYCLE_S)
    change = np.abs(np.diff(dq, axis=0)) / (DAWM.max_acceleration * CYCLE_S**2)
    assert np.percentile(change.max(axis=1), 95) < 1.0
    np.testing.assert_array_equal(setpoints[0], path_of(option)[0])
    np.testing.assert_array_equal(setpoints[-1], path_of(option)[-1])


def test_a_single_straight_piece_and_a_path_of_one_point_are_timed_too() -> None:
    base = DAWM.home[TRACKER.base] + 0.05
    (goal,) = TRACKER.track(base[None], TRACKER.hands(DAWM.home), DAWM.home)
    setpoints = timed(np.stack([DAWM.home, goal]), TRACKER, CYCLE_S)
    assert len(setpoints) > 20
    np.testing.assert_array_equal(setpoints[-1], goal)
    assert len(timed(DAWM.home[None], TRACKER, CYCLE_S)) == 1


def test_every_setpoint_of_a_timed_path_holds_the_hands_to_1e_9(option: Option) -> None:
    poses = TRACKER.hands(DAWM.home)
    for q in timed(path_of(option), TRACKER, CYCLE_S):
        assert np.abs(TRACKER.hands(q) - poses).max() < 1e-9


def test_a_route_continues_from_any_point_near_the_path(option: Option) -> None:
    setpoints = timed(path_of(option), TRACKER, CYCLE_S)
    for pace in (1.0, 0.3):
        route, q = Route(setpoints), setpoints[0]
        for cycle in range(10 * len(setpoints)):
            q = q + route.step(q, pace)
            if cycle == 50:
                q = q + 1e-3 * np.resize([1.0, -1.0], len(q))
            if (q == route.end).all():
                break
            nearest = np.abs(setpoints - q).max(axis=1).min()
            assert nearest < 2e-2
            assert cycle < 150 / pace or nearest < 6e-3
        assert not route.step(q, pace).any()
        assert route.done > 0.99


def test_a_path_that_moves_the_hands_is_timed_unchanged(option: Option) -> None:
    path = np.linspace(DAWM.home, DAWM.home + 0.2, 21)
    setpoints = timed(path, TRACKER, CYCLE_S, hands_move=True)
    off = setpoints - DAWM.home
    np.testing.assert_allclose(off, np.tile(off[:, :1], (1, DAWM.n)), atol=1e-12)
    np.testing.assert_array_equal(setpoints[-1], path[-1])


# A robot that stands at its stop distance: every way of the advisor's leads away first.


LAB = CellModel.load("lab")
GR = LAB.robots["gr"]
EXACT = ExactClearance(LAB, "gr")
GR_TRACKER = ConstraintTracker(GR)
ENOUGH_M = FINE_SHARE * MARGIN_M


def at_a_body(generator: np.random.Generator) -> Array:
    """A configuration less than a tenth of a millimetre beyond some stop distance."""
    while True:
        far, near = (generator.uniform(GR.lower, GR.upper) for _ in range(2))
        if EXACT.measure(far).room_m < 0.02 or EXACT.measure(near).room_m > 0.0:
            continue
        while not 0.0 < EXACT.measure(far).room_m < 1e-4:
            middle = (far + near) / 2
            far, near = (middle, near) if EXACT.measure(middle).room_m > 0.0 else (far, middle)
        return far


def spaces(start: Array) -> list[Space]:
    return [HandsMoved(GR), HandsKept(GR_TRACKER, GR_TRACKER.hands(start))]


@pytest.mark.parametrize("seed", range(6))
def test_clearance_rises_with_every_step_within_limits(seed: int) -> None:
    start = at_a_body(np.random.default_rng(seed))
    for space in spaces(start):
        way = parted(GR, space, EXACT, start, ENOUGH_M)
        rooms = [EXACT.measure(q).room_m for q in way]
        np.testing.assert_array_equal(way[0], start)
        assert (np.diff(rooms) > 0.0).all()
        assert ((way >= GR.lower) & (way <= GR.upper)).all()
        assert (np.abs(np.diff(way[:, space.free], axis=0)) <= FINE + 1e-9).all()
        if isinstance(space, HandsMoved):
            assert rooms[-1] >= ENOUGH_M
        else:
            assert np.abs(GR_TRACKER.hands(way[-1]) - GR_TRACKER.hands(start)).max() < 1e-9


def test_a_robot_with_clearance_stays_in_place() -> None:
    assert len(parted(GR, HandsMoved(GR), EXACT, GR.home, ENOUGH_M)) == 1


def test_a_path_begins_with_the_retreat() -> None:
    start = at_a_body(np.random.default_rng(1))
    space = HandsMoved(GR)
    goal = parted(GR, space, EXACT, start, 5 * ENOUGH_M)[-1]
    path = PathPlanner(GR, space, EXACT, np.random.default_rng(2), start).to(goal)
    out = parted(GR, space, EXACT, start, ENOUGH_M)
    np.testing.assert_array_equal(path[: len(out)], out)
    np.testing.assert_allclose(path[-1], goal, atol=1e-9)
    assert min(EXACT.measure(q).room_m for q in path[len(out) :]) >= 0.8 * ENOUGH_M
