import numpy as np
import pytest

from deltaq_controllers.camera.focus import FocusTracker
from deltaq_controllers.interface import ControllerError

VELOCITY = np.array([0.2, -0.1, 0.05])


def test_a_focus_in_steady_motion_is_carried_ahead_to_where_it_will_be() -> None:
    tracker = FocusTracker()
    for k in range(40):
        tracker.update(0.012 * k * VELOCITY, 0.012 * k)
    np.testing.assert_allclose(tracker.velocity, VELOCITY, rtol=1e-6)
    np.testing.assert_allclose(tracker.ahead(0.06), (0.012 * 39 + 0.06) * VELOCITY, rtol=1e-6)


def test_a_state_seen_twice_counts_once() -> None:
    tracker = FocusTracker()
    for k in range(40):
        for _ in range(1 + k % 3):
            tracker.update(0.012 * k * VELOCITY, 0.012 * k)
    np.testing.assert_allclose(tracker.velocity, VELOCITY, rtol=1e-6)


def test_states_that_were_missed_do_not_disturb_the_velocity() -> None:
    tracker = FocusTracker()
    for k in [*range(20), 25, 26, 33, 40]:
        tracker.update(0.012 * k * VELOCITY, 0.012 * k)
    np.testing.assert_allclose(tracker.velocity, VELOCITY, rtol=1e-3)


@pytest.mark.parametrize("time_s", [10.0, -1.0])
def test_after_a_long_silence_and_on_another_clock_the_estimate_starts_anew(time_s: float) -> None:
    tracker = FocusTracker()
    tracker.update(np.zeros(3), 0.0)
    tracker.update(0.012 * VELOCITY, 0.012)
    tracker.update(np.ones(3), time_s)
    np.testing.assert_array_equal(tracker.velocity, np.zeros(3))
    np.testing.assert_array_equal(tracker.ahead(0.06), np.ones(3))


def test_before_the_first_measurement_there_is_nothing_to_carry_ahead() -> None:
    with pytest.raises(ControllerError, match="call update"):
        FocusTracker().ahead(0.06)
