import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from uncompiled import as_python

_LAW = as_python("deltaq_controllers.redundancy")
DEGREES, Emergency, WeightedGradient = _LAW.DEGREES, _LAW.Emergency, _LAW.WeightedGradient
damped_rates, emergency_rates, weighted_rates = _LAW.damped_rates, _LAW.emergency_rates, _LAW.weighted_rates
inverse_weights, limit_gradient = _LAW.inverse_weights, _LAW.limit_gradient

LOWER, UPPER = np.deg2rad([-185.0, -155, -130, -350, -130, -350]), np.deg2rad([185.0, 35, 154, 350, 130, 350])
MIDDLE = 0.5 * (LOWER + UPPER)
AT_REST = np.zeros(6)


def inverse_weight(limit_scale: float) -> float:
    """W^-1 of A2, half way between the middle and the upper end of its range."""
    q = MIDDLE + 0.25 * (UPPER - LOWER)
    return float(inverse_weights(WeightedGradient(LOWER, UPPER, limit_scale, 0.0), q, AT_REST)[1])


@pytest.mark.nightly
def test_the_scale_of_the_weights_makes_the_unit_of_angle_explicit() -> None:
    assert inverse_weight(1.0) == pytest.approx(0.05, abs=0.005)
    assert inverse_weight(DEGREES) == pytest.approx(0.994, abs=0.001)


def test_the_gradient_of_11_is_as_printed(random: np.random.Generator) -> None:
    q = random.uniform(LOWER + 0.1, UPPER - 0.1)
    printed = (UPPER - LOWER) ** 2 * (2 * q - UPPER - LOWER) / ((q - UPPER) ** 2 * (q - LOWER) ** 2)
    np.testing.assert_allclose(limit_gradient(q, LOWER, UPPER), printed, rtol=1e-9)


@pytest.mark.parametrize("q", [LOWER, UPPER, LOWER - 0.1, UPPER + 0.1])
def test_at_a_limit_and_past_it_weights_are_finite_and_hold_the_joint(q: np.ndarray) -> None:
    inverse = inverse_weights(WeightedGradient(LOWER, UPPER, DEGREES, 0.0), q, AT_REST)
    assert np.isfinite(inverse).all()
    assert (inverse < 1e-2).all()


def test_without_damping_the_task_is_met_exactly_despite_sub_tasks(
    random: np.random.Generator,
) -> None:
    jacobian, task, field = random.normal(size=(2, 6)), random.normal(size=2), random.normal(size=6)
    inverse = random.uniform(0.1, 1.0, 6)
    rates = damped_rates(jacobian, inverse, task, field, 0.0)
    np.testing.assert_allclose(jacobian @ rates, task, atol=1e-12)
    W_inverse = np.diag(inverse)
    pseudo = W_inverse @ jacobian.T @ np.linalg.inv(jacobian @ W_inverse @ jacobian.T)
    law = pseudo @ task + (np.eye(6) - pseudo @ jacobian) @ W_inverse @ field
    np.testing.assert_allclose(rates, law, atol=1e-12)


def test_a_task_that_the_joints_cannot_do_gives_finite_rates(random: np.random.Generator) -> None:
    jacobian = np.vstack([random.normal(size=6), np.zeros(6)])
    weights = WeightedGradient(LOWER, UPPER, DEGREES, 0.03)
    assert np.abs(weighted_rates(weights, MIDDLE, jacobian, np.ones(2), np.zeros(6), 1.0)).max() < 100


def test_a_joint_is_held_on_approach_to_its_limit_and_free_on_retreat() -> None:
    q = MIDDLE.copy()
    q[1] = UPPER[1] - math.radians(1.0)
    jacobian = np.array([[0.0, 1.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    weights = WeightedGradient(LOWER, UPPER, DEGREES, 0.0)
    way_in = weighted_rates(weights, q, jacobian, np.array([1.0, 0.0]), np.zeros(6), 1.0)
    way_out = weighted_rates(weights, q, jacobian, np.array([-1.0, 0.0]), np.zeros(6), 1.0)
    assert way_in[1] < 0.01
    np.testing.assert_allclose(way_in[1] + way_in[2], 1.0)
    assert way_out[1] == pytest.approx(-0.5, abs=0.01)


@pytest.mark.long
@given(
    arrays(float, 6, elements=st.floats(0.0, 1.0)),
    arrays(float, (2, 6), elements=st.floats(-2, 2)),
    arrays(float, 2, elements=st.floats(-2, 2)),
    arrays(float, 6, elements=st.floats(-2, 2)),
)
def test_no_joint_that_approaches_its_limit_is_ever_free(
    share: np.ndarray, jacobian: np.ndarray, task: np.ndarray, field: np.ndarray
) -> None:
    q = LOWER + share * (UPPER - LOWER)
    weights = WeightedGradient(LOWER, UPPER, DEGREES, 0.03)
    rates = weighted_rates(weights, q, jacobian, task, field, 1.0)
    weighed = inverse_weights(weights, q, AT_REST)
    # whichever joints were released, the solution is the law's for weights that release none on its way in
    gradient = limit_gradient(q, LOWER, UPPER)
    free = (gradient * rates < 0) & (weighed < 0.99)
    candidates = [
        damped_rates(jacobian, np.where(mask, 1.0, weighed), task, field, 0.03**2)
        for mask in (np.array([bool(bits >> k & 1) for k in range(6)]) for bits in range(64))
        if not (mask & ~free).any()
    ]
    assert any(np.allclose(rates, candidate, atol=1e-9) for candidate in candidates)


def test_at_the_limit_an_evasion_is_free_to_leave_and_held_to_stay() -> None:
    weights = WeightedGradient(LOWER, UPPER, DEGREES, 0.03)
    q = UPPER.copy()
    np.testing.assert_allclose(emergency_rates(weights, q, -np.ones(6)), -np.ones(6))
    assert (emergency_rates(weights, q, np.ones(6)) < 1e-2).all()


def test_the_emergency_law_has_a_hysteresis_of_clearance() -> None:
    emergency = Emergency(0.08, 0.12)
    seen = [emergency.update(clearance) for clearance in (0.2, 0.1, 0.07, 0.1, 0.119, 0.121, 0.1)]
    assert seen == [False, False, True, True, True, False, False]
