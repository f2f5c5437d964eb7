from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_emulator.settings import FIELD_OF_VIEW, LateBudget


def exceeded_after(budget: LateBudget, cycles: list[bool]) -> int | None:
    """The cycle in which the budget was exceeded first."""
    for number, late in enumerate(cycles, start=1):
        budget.cycle(late)
        if budget.exceeded is not None:
            return number
    return None


@pytest.mark.parametrize(
    ("rule", "exceeded"), [("consecutive", None), ("total", 7), ("share", None)], ids=lambda value: str(value)
)
def test_late_cycles_with_answers_between_them_are_too_many_only_where_all_are_counted(
    rule: str, exceeded: int | None
) -> None:
    assert exceeded_after(LateBudget(rule, 3, 50.0), [True, False] * 100) == exceeded


def test_a_share_is_exceeded_by_one_more_than_that_share_of_a_thousand() -> None:
    assert exceeded_after(LateBudget("share", 0, 2.5), [True] * 100) == 26


def test_late_cycles_leave_the_field_of_view_after_a_thousand() -> None:
    budget = LateBudget("share", 0, 2.5)
    ten_of_a_thousand = [True] * 10 + [False] * (FIELD_OF_VIEW - 10)
    assert exceeded_after(budget, ten_of_a_thousand * 5) is None
    assert budget.counted == 10
    assert exceeded_after(budget, [True] * 10 + [False] * 500 + [True] * 100) == 10 + 500 + 16


def test_a_new_session_counts_from_zero() -> None:
    for rule in ("consecutive", "total", "share"):
        budget = LateBudget(rule, 3, 0.3)
        assert exceeded_after(budget, [True] * 4) == 4
        budget.begin_session()
        assert (budget.exceeded, budget.counted) == (None, 0)
        assert exceeded_after(budget, [True] * 4) == 4


def test_a_budget_of_nothing_permits_nothing() -> None:
    for rule in ("consecutive", "total", "share"):
        assert exceeded_after(LateBudget(rule, 0, 0.0), [False] * 5 + [True]) == 6


@given(st.lists(st.booleans(), max_size=2500))
def test_the_share_counts_what_a_window_over_the_whole_history_would(cycles: list[bool]) -> None:
    budget = LateBudget("share", 0, 100.0)
    for late in cycles:
        budget.cycle(late)
    assert budget.counted == sum(cycles[-FIELD_OF_VIEW:])
