import numpy as np
import pytest

from deltaq_controllers.interface import LastIncrement, RobotView
from deltaq_protocol.brake import brake_cycles, brake_increment

MAX_DDQ = np.array([0.001, 0.002])


def view(cycle: int, q_cmd: np.ndarray) -> RobotView:
    return RobotView(cycle, 0.012 * cycle, q_cmd, q_cmd)


def test_the_last_increment_is_the_difference_of_consecutive_setpoints() -> None:
    last = LastIncrement(MAX_DDQ)
    np.testing.assert_array_equal(last.update(view(7, np.array([1.0, 2.0]))), [0.0, 0.0])
    np.testing.assert_allclose(last.update(view(8, np.array([1.1, 1.9]))), [0.1, -0.1])
    np.testing.assert_allclose(last.update(view(8, np.array([1.1, 1.9]))), [0.1, -0.1])


@pytest.mark.parametrize("missed", [1, 2, 5, 30])
@pytest.mark.parametrize("dq", [[0.01, -0.004], [0.0005, 0.0], [0.0, 0.0]])
def test_over_missed_cycles_the_robot_is_known_to_have_braked(missed: int, dq: list[float]) -> None:
    last = LastIncrement(MAX_DDQ)
    q, admitted = np.array([1.0, 2.0]), np.array(dq)
    last.update(view(0, q))
    cycles = brake_cycles(admitted, MAX_DDQ)
    increments = [brake_increment(admitted, cycles, step) for step in range(missed + 1)]
    found = last.update(view(missed + 1, q + np.sum(increments, axis=0)))
    np.testing.assert_allclose(found, increments[-1], atol=1e-12)


def test_a_server_that_starts_again_starts_from_rest() -> None:
    last = LastIncrement(MAX_DDQ)
    last.update(view(100, np.zeros(2)))
    np.testing.assert_array_equal(last.update(view(1, np.ones(2))), [0.0, 0.0])


def test_where_something_in_flight_was_lost_the_last_increment_is_still_the_same() -> None:
    last, dq = LastIncrement(MAX_DDQ), np.array([0.01, 0.02])
    last.update(view(4, np.array([1.0, 2.0])))
    reckoned = view(5, np.array([1.0, 2.0]) + dq)
    np.testing.assert_allclose(last.update(reckoned), dq)
    for cycle in (5, 4):
        np.testing.assert_allclose(last.update(view(cycle, np.array([1.0, 2.0]))), dq)


def test_an_increment_under_way_counts_as_commanded() -> None:
    last = LastIncrement(MAX_DDQ)
    seen = view(4, np.array([1.0, 2.0]))
    last.update(seen)
    dq = np.array([0.01, 0.02])
    ahead = seen.after(4, dq)
    np.testing.assert_allclose(ahead.q_cmd, [1.01, 2.02])
    np.testing.assert_allclose(last.update(ahead), dq)
    np.testing.assert_array_equal(ahead.q, seen.q)
