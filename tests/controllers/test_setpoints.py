"""Where another robot will be, how old the view of it is, and what is foreseen when nobody sees it any more."""

from dataclasses import replace

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.interface import ControllerError, HeldBack, RobotView, View
from deltaq_controllers.surroundings.setpoints import STALE_S, Foreseen, SetpointTracker
from deltaq_emulator.drives import Servo
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Sight

CYCLE_S = 0.012
VELOCITY = np.array([0.2, -0.1])


def seen(cycle: int, q_cmd: Array, time_s: float | None = None) -> RobotView:
    """A robot that is still far behind its setpoint."""
    return RobotView(cycle, cycle * CYCLE_S if time_s is None else time_s, np.zeros_like(q_cmd), q_cmd)


def at(cycle: int) -> Array:
    return cycle * CYCLE_S * VELOCITY


def test_a_robot_in_steady_motion_is_predicted_at_its_setpoints() -> None:
    tracker = SetpointTracker(CYCLE_S)
    for cycle in range(5):
        tracker.update(seen(cycle, at(cycle)))
    np.testing.assert_allclose(tracker.velocity, VELOCITY)
    np.testing.assert_allclose(tracker.ahead(10 * CYCLE_S), at(14))


def test_planned_increments_are_predicted_and_what_follows_continues_them() -> None:
    tracker, planned = SetpointTracker(CYCLE_S), (np.array([0.003]), np.array([0.004]), np.array([0.004]))
    for cycle in range(3):
        tracker.update(seen(cycle, np.array([0.002 * cycle])))
    tracker.update(replace(seen(3, np.array([0.006])), planned=planned))
    reached = [0.0, 0.006, 0.009, 0.013, 0.017, 0.021]
    for cycles, expected in ((-3, 0), (0, 1), (1, 2), (2, 3), (3, 4), (4, 5)):
        np.testing.assert_allclose(tracker.ahead(cycles * CYCLE_S), reached[expected], atol=1e-12)
    np.testing.assert_allclose(tracker.ahead(1.5 * CYCLE_S), 0.011)
    np.testing.assert_allclose(tracker.velocity, 0.004 / CYCLE_S)
    tracker.update(seen(4, np.array([0.006])))  # none was admitted
    np.testing.assert_allclose(tracker.ahead(0.0), 0.006)


def test_jittering_stamps_and_missed_states_change_nothing() -> None:
    tracker = SetpointTracker(CYCLE_S)
    for cycle in (0, 1, 2, 2, 6, 7):
        tracker.update(seen(cycle, at(cycle), time_s=cycle * CYCLE_S + 0.005 * (cycle % 2)))
    np.testing.assert_allclose(tracker.velocity, VELOCITY)


def test_an_acceleration_estimate_improves_the_prediction() -> None:
    tracker, q = SetpointTracker(CYCLE_S), np.zeros(1)
    places = [q := q + 1e-4 * cycle for cycle in range(20)]
    for cycle in range(10):
        tracker.update(seen(cycle, places[cycle]))
    steady = places[9] + 2 * (places[9] - places[8])
    assert abs(tracker.ahead(2 * CYCLE_S) - places[11])[0] < 0.3 * abs(steady - places[11])[0]


def test_an_unobserved_motion_is_predicted_to_end() -> None:
    tracker = SetpointTracker(CYCLE_S)
    for cycle in range(5):
        tracker.update(seen(cycle, at(cycle)))
    far = tracker.ahead(60.0)
    assert np.linalg.norm(far - at(4)) < 0.5 * np.linalg.norm(VELOCITY)
    np.testing.assert_allclose(tracker.ahead(61.0), far)


@pytest.mark.parametrize("cycle", [1, 500])
def test_after_a_long_silence_or_a_new_robot_server_the_estimate_restarts(cycle: int) -> None:
    tracker = SetpointTracker(CYCLE_S)
    for before in range(100, 105):
        tracker.update(seen(before, at(before)))
    tracker.update(seen(cycle, np.ones(2)))
    np.testing.assert_array_equal(tracker.ahead(0.1), np.ones(2))


def test_without_a_view_there_is_no_prediction() -> None:
    with pytest.raises(ControllerError, match="call update"):
        SetpointTracker(CYCLE_S).ahead(0.06)


@pytest.fixture(scope="module")
def lab() -> CellModel:
    return CellModel.load("lab")


@pytest.mark.parametrize("dead_time_s", [0.0, 0.016, 0.046, 0.1])
@pytest.mark.parametrize("slower", ["gr", "fr"])
def test_the_prediction_compensates_different_lags_of_the_drives(slower: str, dead_time_s: float) -> None:
    """FR goes to the setpoint that is foreseen of GR: then the drives of both are at one place at one time."""
    robots = CellModel.load("lab").robots
    lags = {name: robot.description.servo_lag for name, robot in robots.items()}
    lags[slower] = lags[slower].model_copy(update={"dead_time_s": dead_time_s})
    for name, robot in robots.items():
        robot.description = robot.description.model_copy(update={"servo_lag": lags[name]})
    other, answer = Foreseen(robots["gr"], robots["fr"], CYCLE_S), np.zeros(1)
    fr, gr = (Servo(np.zeros(1), lags[name], CYCLE_S) for name in ("fr", "gr"))
    apart = []
    for cycle in range(300):
        setpoint = 0.1 * np.sin(2.0 * cycle * CYCLE_S + np.zeros(1))
        fr.advance(answer)
        gr.advance(setpoint)
        other.update(seen(cycle, answer), seen(cycle, setpoint))
        answer = other.ahead()  # the setpoint of the next cycle
        apart.append(abs(float(gr.q[0] - fr.q[0])))
    assert max(apart[100:]) < 5e-4  # at 0.2 rad/s the lags alone would make up to 0.011


def foreseen(lab: CellModel) -> Foreseen:
    return Foreseen(lab.robots["gr"], lab.robots["fr"], CYCLE_S)


def moving(cycle: int, time_s: float) -> RobotView:
    return RobotView(cycle, time_s, np.zeros(9), np.full(9, 0.1 * cycle * CYCLE_S))


def test_prediction_covers_the_age_of_the_view_and_the_delay_of_the_answer(lab: CellModel) -> None:
    other = foreseen(lab)
    own = RobotView(0, 10.0, np.zeros(6), np.zeros(6), ahead_cycles=5)
    for cycle in range(5):
        other.update(own, moving(cycle, 10.0 - 3 * CYCLE_S))
    assert other.ahead() == pytest.approx(np.full(9, 0.1 * (4 + 3 + 5 + 1) * CYCLE_S))
    assert other.age_s == pytest.approx(3 * CYCLE_S)


def test_a_planned_leap_is_predicted_as_the_fastest_motion(lab: CellModel) -> None:
    other, fastest = foreseen(lab), lab.robots["gr"].max_velocity * CYCLE_S
    planned = (np.full(len(fastest), 1e6), np.full(len(fastest), -1e6))
    for cycle in range(3):
        own = RobotView(cycle, cycle * CYCLE_S, np.zeros(6), np.zeros(6))
        rest = np.zeros(len(fastest))
        other.update(own, RobotView(cycle, cycle * CYCLE_S, rest, rest, planned=planned))
        assert (np.abs(other.ahead()) <= 2 * fastest).all()


def test_a_frozen_view_becomes_stale_then_lost_and_then_fresh_again(lab: CellModel) -> None:
    other, sights = foreseen(lab), {}
    assert other.sight is Sight.LOST
    for cycle in range(400):
        known = cycle if not 50 <= cycle < 300 else 49
        own = RobotView(cycle, cycle * CYCLE_S, np.zeros(6), np.zeros(6))
        other.update(own, moving(known, known * CYCLE_S))
        sights[cycle] = other.sight
        if 60 <= cycle < 300:
            assert np.abs(other.ahead() - 0.1 * 49 * CYCLE_S).max() < 0.05, "no motion for good"
    assert {sights[cycle] for cycle in range(57)} == {Sight.FRESH}
    assert {sights[cycle] for cycle in range(59, 130)} == {Sight.STALE}
    assert {sights[cycle] for cycle in range(134, 300)} == {Sight.LOST}
    assert {sights[cycle] for cycle in range(300, 400)} == {Sight.FRESH}
    assert other.velocity == pytest.approx(np.full(9, 0.1))


def test_a_stale_view_is_predicted_to_stay_at_its_last_predicted_setpoint(lab: CellModel) -> None:
    other = foreseen(lab)
    expected = {}
    for cycle in range(80):
        own = RobotView(cycle, cycle * CYCLE_S, np.zeros(6), np.zeros(6))
        known = min(cycle, 50)
        other.update(own, moving(known, known * CYCLE_S))
        expected[cycle] = other.ahead()[0] / (0.1 * CYCLE_S)
        is_stale = cycle > 58
        assert other.sight is (Sight.STALE if is_stale else Sight.FRESH)
        if cycle > 0:
            assert other.velocity == pytest.approx(np.full(9, 0.0 if is_stale else 0.1))
    assert expected[58] == pytest.approx(59)
    stays = (
        50 + STALE_S / CYCLE_S + 1
    )  # the next increment takes effect one cycle later; the usual delay rises slowly
    assert all(stays <= expected[cycle] < stays + 0.4 for cycle in range(59, 80))


def test_a_view_that_is_always_late_is_never_taken_for_usual(lab: CellModel) -> None:
    other = foreseen(lab)
    for cycle in range(10_000):
        own = RobotView(cycle, cycle * CYCLE_S + 0.8, np.zeros(6), np.zeros(6))
        other.update(own, moving(cycle, cycle * CYCLE_S))
    assert other.sight is Sight.STALE


def test_the_others_are_delayed_by_the_given_views_and_the_own_robot_is_not() -> None:
    class Watching:
        def increment(self, view: View) -> Array:
            return np.array([view.own.cycle, view.others["gr"].cycle])

    late = HeldBack(Watching(), 2)
    told = [late.increment(View(seen(k, at(k)), {"gr": seen(k, at(k))})).tolist() for k in range(5)]
    assert told == [[0, 0], [1, 0], [2, 0], [3, 1], [4, 2]]
