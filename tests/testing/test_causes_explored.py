"""Of all that can happen to a Robot Server and its gate, nothing looks as if the gate could not have caused it."""

import pytest

from deltaq_proofs.model_checker.explore import explore
from deltaq_proofs.model_checker.one_joint import ROBOT
from deltaq_proofs.model_checker.system import System


@pytest.mark.long
@pytest.mark.parametrize(
    ("faults", "cycles"),
    [
        (1, 4),
        pytest.param(0, 40, marks=pytest.mark.nightly),
        pytest.param(2, 3, marks=pytest.mark.nightly),
        pytest.param(1, 7, marks=pytest.mark.nightly),
    ],
)
def test_losses_delays_duplicates_and_crashes_give_no_impossible_state(faults, cycles):
    system = System()
    assert explore(system, faults, cycles).counterexample is None
    assert system._sim.taken > 0
    assert not system._sim.counters[f"impossible_states_{ROBOT}"]
