"""Each solver of the hands' programmes that is installed finds what DAQP finds; others are told as not installed."""

from __future__ import annotations

import importlib.util
from functools import cache

import numpy as np
import pytest

from deltaq_controllers.modes.motion import ModeName
from deltaq_experiments.qp_solvers import SOLVERS, Programme, by_daqp, programmes, timed

pytestmark = pytest.mark.long


@cache
def asked() -> list[Programme]:
    return programmes("lab", "fr", ModeName.COUPLED, duration_s=0.1, every=5)


def test_the_programmes_are_those_that_were_solved_on_the_way() -> None:
    assert len(asked()) >= 12
    for one in asked():
        x = by_daqp(one)
        assert x is not None
        every = np.concatenate([x, one.rows @ x])
        assert np.all(every <= one.high + 1e-9)
        assert np.all(every >= one.low - 1e-9)


@pytest.mark.parametrize(
    ("solver", "off"), [("DAQP", 0.0), ("quadprog", 1e-5), ("ProxQP", 1e-3), ("PIQP", 0.1), ("OSQP", 0.5)]
)
def test_a_solver_that_is_installed_finds_the_same(solver: str, off: float) -> None:
    package, solve = SOLVERS[solver]
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed, and is no dependency")
    answers = [(solve(one), by_daqp(one)) for one in asked()]
    found = [float(np.abs(x - best).max()) for x, best in answers if x is not None and best is not None]
    assert len(found) > 0.9 * len(asked())
    assert max(found) <= off


def test_a_solver_that_is_not_installed_is_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SOLVERS, "Another", ("no_such_solver", by_daqp))
    times = {one.solver: one for one in timed(asked())}
    assert times["Another"] == ("Another", None, None, None, None)
    assert times["DAQP"].median_us is not None
    assert times["DAQP"].median_us > 0.0
