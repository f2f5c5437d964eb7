"""The best configuration that keeps the hands in place is an option, whatever else is found where they may leave."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import Option, Progress, advise
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array
from studies.advised_starts import CELLS, starts

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
def test_the_best_in_place_is_an_option_with_a_path_where_the_hands_may_leave(
    robot: str, number: int
) -> None:
    found, _ = asked(robot, number, True)
    in_place = [option for option in found if not option.hands_leave]
    assert len(found) <= COUNT
    best = asked(robot, number, False)[0][0] if robot != "fr" else None  # without a joint to spare it stays
    expected = starts_of(robot)[number] if best is None else best.q
    assert any((option.q == expected).all() and option.path is not None for option in in_place)


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("robot", ["gr", "dawm", "fr"])
def test_options_that_are_shown_keep_their_ranks(robot: str) -> None:
    """An operator who has read a rank may choose it at once."""
    for number in range(3):
        found, told = asked(robot, number, True)
        assert [option.energy for option in found] == sorted(option.energy for option in found)
        shown = [progress.options for progress in told if progress.options]
        assert list(shown[-1]) == found
        for options in shown:
            for option, final in zip(options, found, strict=True):
                np.testing.assert_array_equal(option.q, final.q)
