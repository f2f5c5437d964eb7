import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from deltaq_controllers.camera.follower import integrate, share_inside

WIDE = np.full(2, 1e3)


def swing(q: np.ndarray) -> np.ndarray:
    """An oscillator that is not linear."""
    return np.array([q[1], -np.sin(q[0])])


def test_the_integrator_is_of_fourth_order() -> None:
    start = np.array([1.0, 0.3])
    fine = integrate(swing, start, 0.8, 0.8 / 1024, WIDE, max_steps=2000)
    errors = [
        np.linalg.norm(integrate(swing, start, 0.8, 0.8 / steps, WIDE) - fine) for steps in (2, 4, 8, 16)
    ]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (np.abs(orders - 4.0) < 0.35).all()


def test_the_integration_ends_where_the_first_joint_reaches_its_cap() -> None:
    cap = np.array([0.03, 0.01])
    moved = integrate(lambda q: np.array([1.0, -2.0]), np.zeros(2), 10.0, 1.0, cap)
    np.testing.assert_allclose(moved, [0.005, -0.01], atol=1e-15)


def test_no_step_covers_more_than_a_fifth_of_the_cap() -> None:
    cap = np.full(2, 0.01)
    visited: list[np.ndarray] = []

    def field(q: np.ndarray) -> np.ndarray:
        visited.append(q.copy())
        return np.array([3.0, 1.0])

    integrate(field, np.zeros(2), 1.0, 1.0, cap)
    hops = np.abs(np.diff(np.array(visited), axis=0))
    assert hops.max() <= 0.2 * 0.01 * (1 + 1e-9)
    assert visited[-1][0] >= 0.0099


def test_a_stiff_repulsion_does_not_exceed_the_cap() -> None:
    cap = np.full(1, 0.01)
    moved = integrate(lambda q: np.array([-1e6 * (q[0] - 0.004)]), np.zeros(1), 0.06, 0.06, cap)
    assert abs(moved[0]) <= 0.01
    assert abs(moved[0] - 0.004) <= 0.002


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.lists(st.floats(-9, 9), min_size=3, max_size=3))
def test_the_share_of_a_step_is_the_largest_that_stays_inside(start: list[float], step: list[float]) -> None:
    cap = np.ones(3)
    share = share_inside(np.array(start), np.array(step), cap)
    assert 0.0 <= share <= 1.0
    assert (np.abs(np.array(start) + share * np.array(step)) <= 1.0 + 1e-12).all()
    if share < 1.0:
        beyond = np.array(start) + (share + 1e-6) * np.array(step)
        assert (np.abs(beyond) > 1.0 - 1e-12).any()
