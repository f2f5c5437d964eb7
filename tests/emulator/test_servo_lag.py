import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_cell.description import ServoLag
from deltaq_cell.drive_lag import transition
from deltaq_emulator.drives import Servo

T = 0.004


def step_response(lag: ServoLag, cycles: int, cycle_s: float = T) -> np.ndarray:
    """Positions at the beginning of each cycle after the setpoint of the first one went from 0 to 1."""
    servo = Servo(np.zeros(1), lag, cycle_s)
    out = []
    for _ in range(cycles):
        out.append(servo.q[0])
        servo.advance(np.ones(1))
    return np.array(out)


def test_a_step_is_reached_without_overshoot_at_damping_one() -> None:
    q = step_response(ServoLag(dead_time_s=0.012, natural_frequency_rad_s=83.0, damping=1.0), 250)
    assert q[-1] == pytest.approx(1.0, abs=1e-9)
    assert (np.diff(q) >= 0.0).all()
    assert q.max() <= 1.0


def test_a_step_overshoots_below_damping_one() -> None:
    q = step_response(ServoLag(dead_time_s=0.0, natural_frequency_rad_s=83.0, damping=0.5), 250)
    # exp(-pi z / sqrt(1 - z^2)) of a step; the setpoint's ramp over the first cycle takes a little away
    assert q.max() - 1.0 == pytest.approx(math.exp(-math.pi * 0.5 / math.sqrt(0.75)), abs=0.01)


@pytest.mark.parametrize(("dead_time_s", "still"), [(0.0, 0), (0.004, 1), (0.012, 3), (0.0139, 3)])
def test_nothing_moves_before_the_dead_time_is_over(dead_time_s: float, still: int) -> None:
    q = step_response(ServoLag(dead_time_s=dead_time_s), still + 2)
    assert not q[: still + 1].any()
    assert q[still + 1] > 0.0


def test_a_dead_time_between_cycles_lies_between_those_of_its_neighbours() -> None:
    shorter, between, longer = (
        step_response(ServoLag(dead_time_s=dead_time_s), 20) for dead_time_s in (0.004, 0.0055, 0.008)
    )
    moving = slice(2, None)
    assert (longer[moving] < between[moving]).all()
    assert (between[moving] < shorter[moving]).all()


@pytest.mark.parametrize("damping", [0.3, 1.0, 1.0 + 1e-7, 2.5, 8.0])
def test_a_ramp_is_followed_at_the_lag_that_theory_gives(damping: float) -> None:
    lag = ServoLag(dead_time_s=0.006, natural_frequency_rad_s=60.0, damping=damping)
    servo = Servo(np.zeros(1), lag, T)
    cycles = 4000
    for k in range(1, cycles + 1):
        servo.advance(np.array([0.5 * k * T]))
    behind_s = cycles * T - servo.q[0] / 0.5
    assert behind_s == pytest.approx(0.006 + 2 * damping / 60.0, abs=1e-9)
    assert servo.dq_dt[0] == pytest.approx(0.5)


@pytest.mark.long
@given(
    st.floats(0.1, 3.0),
    st.floats(1.0, 200.0),
    st.floats(0.0, 0.03),
    st.lists(st.floats(-1, 1), min_size=3, max_size=12),
)
def test_the_update_is_exact_at_any_cycle(
    damping: float, frequency: float, dead_time_s: float, setpoints: list[float]
) -> None:
    """Two half cycles along the same interpolated setpoint end where one whole cycle does."""
    lag = ServoLag(dead_time_s=dead_time_s, natural_frequency_rad_s=frequency, damping=damping)
    whole, half = Servo(np.zeros(1), lag, T), Servo(np.zeros(1), lag, T / 2)
    last = 0.0
    for setpoint in [*setpoints, *[setpoints[-1]] * 10]:
        whole.advance(np.array([setpoint]))
        half.advance(np.array([(last + setpoint) / 2]))
        half.advance(np.array([setpoint]))
        last = setpoint
        assert whole.q[0] == pytest.approx(half.q[0], abs=1e-9)
        assert whole.dq_dt[0] == pytest.approx(half.dq_dt[0], abs=1e-6)


@given(st.floats(0.05, 5.0), st.floats(1.0, 500.0), st.floats(1e-4, 0.05), st.floats(1e-4, 0.05))
def test_transitions_follow_one_another(
    damping: float, frequency: float, first: float, second: float
) -> None:
    together = transition(first + second, frequency, damping)
    one_by_one = transition(second, frequency, damping) @ transition(first, frequency, damping)
    assert together == pytest.approx(one_by_one, rel=1e-6, abs=1e-6 * frequency)
