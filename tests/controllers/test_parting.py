"""A robot that stands at its stop distance: every way of the advisor's leads away first."""

from __future__ import annotations

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
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
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array

CELL = CellModel.load("lab")
GR = CELL.robots["gr"]
EXACT = ExactClearance(CELL, "gr")
TRACKER = ConstraintTracker(GR)
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
    return [HandsMoved(GR), HandsKept(TRACKER, TRACKER.hands(start))]


@pytest.mark.parametrize("seed", range(6))
def test_the_room_rises_with_every_step_and_no_limit_is_passed(seed: int) -> None:
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
            assert np.abs(TRACKER.hands(way[-1]) - TRACKER.hands(start)).max() < 1e-9


def test_who_has_room_goes_nowhere() -> None:
    assert len(parted(GR, HandsMoved(GR), EXACT, GR.home, ENOUGH_M)) == 1


def test_a_path_begins_with_the_way_out() -> None:
    start = at_a_body(np.random.default_rng(1))
    space = HandsMoved(GR)
    goal = parted(GR, space, EXACT, start, 5 * ENOUGH_M)[-1]
    path = PathPlanner(GR, space, EXACT, np.random.default_rng(2), start).to(goal)
    out = parted(GR, space, EXACT, start, ENOUGH_M)
    np.testing.assert_array_equal(path[: len(out)], out)
    np.testing.assert_allclose(path[-1], goal, atol=1e-9)
    assert min(EXACT.measure(q).room_m for q in path[len(out) :]) >= 0.8 * ENOUGH_M
