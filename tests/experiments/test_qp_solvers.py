"""Each solver of the hands' programmes that is installed finds what DAQP finds; others are told as not installed."""

from __future__ import annotations

import importlib.util

import pytest

from deltaq_controllers.modes.motion import ModeName
from deltaq_experiments.qp_solvers import SOLVERS, programmes, timed

pytestmark = pytest.mark.long


def test_solvers_that_are_installed_are_timed_on_the_same_programmes() -> None:
    asked = programmes("lab", "fr", ModeName.COUPLED, duration_s=0.1, every=5)
    assert len(asked) >= 12
    for one in timed(asked):
        package, _ = SOLVERS[one.solver]
        if importlib.util.find_spec(package) is None:
            assert one == (one.solver, None, None, None, None)
            continue
        assert one.median_us is not None
        assert one.off is not None
        assert one.median_us > 0.0
        if one.solver in ("DAQP", "quadprog"):
            assert one.off < 1e-6
            assert one.failed == 0
