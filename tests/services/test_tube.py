"""The tube holds every configuration a lagging robot can be in."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltaq_cell.description import ServoLag
from deltaq_emulator.servo import Servo
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_services.sim.tube import Branch, Strip, Windows, tube

LAG = 6
CYCLE_S = 0.012
SERVO = ServoLag()


def windows_of(piece):
    if isinstance(piece, Windows) and piece.first < piece.last:
        return [leaf for half in piece.halves() for leaf in windows_of(half)]
    return [piece]


def is_inside(strip, q, slack):
    """Whether some t of the strip is within its deviation of q."""
    low, high = -1.0, 1.0
    for offset, along, aside in zip(q - strip.middle, strip.direction, strip.deviation + slack, strict=True):
        if along == 0.0:
            low, high = (low, high) if abs(offset) <= aside else (1.0, -1.0)
            continue
        ends = sorted([(offset - aside) / along, (offset + aside) / along])
        low, high = max(low, ends[0]), min(high, ends[1])
    return low <= high


def test_setpoints_of_a_branch_are_those_the_robot_server_sends():
    dq = np.array([0.01, -0.02])
    cycles = brake_cycles(dq, np.array([0.003, 0.003]))
    sent = np.array([0.5, 0.5]) + np.cumsum([brake_increment(dq, cycles, k) for k in range(cycles)], axis=0)
    np.testing.assert_allclose(Branch(dq, cycles, -1).setpoints(np.array([0.5, 0.5])), sent, atol=1e-15)
    np.testing.assert_allclose(Branch(dq, cycles, 2).setpoints(sent[2]), sent[3:], atol=1e-15)


def test_a_robot_at_rest_has_one_point_and_one_window():
    piece = tube(np.tile([1.0, 2.0], (LAG, 1)), Branch(np.zeros(2), 1, 1), LAG)
    np.testing.assert_array_equal(piece.strip().middle, [1.0, 2.0])
    np.testing.assert_array_equal(piece.strip().half, [0.0, 0.0])
    assert piece.first == piece.last


def test_a_branch_that_stands_has_no_setpoints_to_come():
    assert Branch(np.zeros(2), 3, -1).setpoints(np.ones(2)).shape == (0, 2)
    assert Branch(np.ones(2), 3, 2).setpoints(np.ones(2)).shape == (0, 2)


@pytest.mark.parametrize("measured", [None, np.array([0.1, 0.2])])
def test_windows_begin_now_and_end_when_the_drives_have_caught_up_with_the_last_setpoint(measured):
    history, cycles = np.tile([1.0, 2.0], (LAG, 1)), 3
    past = LAG if measured is None else LAG + 1
    still = tube(history, Branch(np.zeros(2), 1, 1), LAG, None if measured is None else history[0])
    assert (still.first, still.last) == (past - 1, past - 1)
    moving = tube(history, Branch(np.full(2, 0.01), cycles, -1), LAG, measured)
    assert (moving.first, moving.last) == (past - 1, past + cycles - 1 + LAG)


def test_a_single_window_and_windows_along_one_line_are_divided_along_their_strip():
    around_a_corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.1]])
    line = np.linspace([0.0, 0.0], [1.0, 2.0], 9)
    for windows in (Windows(around_a_corner, 2, 2, 2), Windows(line, 2, 2, 8)):
        assert [type(half) for half in windows.halves()] == [Strip, Strip]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_strip_and_its_halves_hold_every_mean_of_its_points(seed):
    random = np.random.default_rng(seed)
    points = np.cumsum(random.normal(size=(random.integers(1, 8), 3)) * random.uniform(0, 1, 3), axis=0)
    pieces = [Strip.around(points)]
    for _ in range(3):
        for weights in random.dirichlet(np.full(len(points), 0.3), size=10):
            assert any(is_inside(piece, weights @ points, 1e-12) for piece in pieces)
        pieces = [half for piece in pieces for half in piece.halves() or (piece,)]


def test_the_strip_of_points_on_a_line_is_the_line():
    strip = Strip.around(np.array([[0.0, 1.0], [2.0, 0.0], [0.5, 0.75]]))
    np.testing.assert_allclose(strip.deviation, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.abs(strip.direction), [1.0, 0.5])
    np.testing.assert_allclose(strip.middle, [1.0, 0.5])


@pytest.mark.parametrize("offset", [-10.0, 0.0, 10.0])
def test_a_strip_lies_along_the_longest_way_and_is_as_wide_as_points_aside_or_beyond_its_ends_need(offset):
    points = np.array([[0.0, 0.0], [1.0, 4.0], [1.5, 2.0], [-1.5, 0.1]])
    start, end, aside, beyond = points + np.array([offset, 0.0])
    wide = Strip.around(np.array([start, end, aside]))
    np.testing.assert_allclose(np.abs(wide.direction), [0.5, 2.0])
    t = (aside - (start + end) / 2) @ wide.direction / (wide.direction @ wide.direction)
    out = aside - (start + end) / 2 - t * wide.direction
    np.testing.assert_allclose(wide.middle, (start + end) / 2 + out / 2, atol=1e-12)
    np.testing.assert_allclose(wide.deviation, np.abs(out) / 2, atol=1e-12)
    longer = Strip.around(np.array([start, end, beyond]))  # its foot on the line is beyond the start
    np.testing.assert_allclose(longer.middle, (start + end) / 2 + (beyond - start) / 2, atol=1e-12)
    np.testing.assert_allclose(longer.deviation, np.abs(beyond - start) / 2, atol=1e-12)


def test_the_halves_of_a_strip_lie_behind_one_another_and_are_as_wide():
    first, second = Strip(np.array([5.0, 1.0]), np.array([2.0, 0.0]), np.array([0.0, 0.1])).halves()
    np.testing.assert_array_equal([first.middle, second.middle], [[4.0, 1.0], [6.0, 1.0]])
    np.testing.assert_array_equal([first.direction, second.direction], [[1.0, 0.0]] * 2)
    np.testing.assert_array_equal([first.deviation, second.deviation], [[0.0, 0.1]] * 2)


def test_division_ends_at_what_no_drive_resolves_and_where_a_strip_is_as_wide_as_long():
    assert Strip(np.zeros(2), np.full(2, 1e-8), np.zeros(2)).halves() == ()
    assert Strip(np.zeros(2), np.full(2, 1e-3), np.full(2, 2e-3)).halves() == ()
    assert len(Strip(np.zeros(2), np.full(2, 1e-3), np.zeros(2)).halves()) == 2


@pytest.mark.parametrize("last", [3, 8, 9])
def test_halving_loses_no_window_and_repeats_none(last):
    points = np.random.default_rng(0).normal(size=(10, 2))
    leaves = windows_of(Windows(points, 2, 2, last))
    assert [(leaf.first, leaf.last) for leaf in leaves] == [(window, window) for window in range(2, last + 1)]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_emulated_drives_never_leave_the_windows_while_they_brake(seed):
    """A robot on a random course is starved; each place of its drives lies in some window of its tube."""
    random = np.random.default_rng(seed)
    n, max_dv = 3, np.array([0.0016, 0.0007, 0.003])
    servo, q_cmd, dq = Servo(np.zeros(n), SERVO, CYCLE_S), np.zeros(n), np.zeros(n)
    history = []
    for _ in range(int(random.integers(3, 60))):
        dq = np.clip(dq + random.uniform(-1, 1, n) * max_dv, -0.03, 0.03)
        q_cmd = q_cmd + dq
        servo.advance(q_cmd)
        history = [*history, q_cmd][-LAG:]
    cycles = brake_cycles(dq, max_dv)
    piece = tube(np.array(history), Branch(dq, cycles, 0), LAG, servo.q if len(history) < LAG else None)
    strips = [leaf.strip() for leaf in windows_of(piece)]
    # the part of a second-order lag that is older than the window
    tail = 0.02 * np.ptp(np.array([*history, servo.q]), axis=0) + 1e-9
    for step in range(1, cycles + 3 * LAG):
        q_cmd = q_cmd + brake_increment(dq, cycles, step)
        servo.advance(q_cmd)
        assert any(is_inside(strip, servo.q, tail) for strip in strips), step
