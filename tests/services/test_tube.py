"""The tube holds every configuration a lagging robot can be in."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spans import exact_drives, is_inside
from spread_drives import SpreadServo

from deltaq_cell.description import ServoLag
from deltaq_cell.kernel.span import off_hull, widths
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_services.sim.tracker import History
from deltaq_services.sim.tube import Branch, DriveBounds, Span, Windows, tube

LAG = 6
CYCLE_S = 0.012
SERVO = ServoLag()


def windows_of(piece):
    if isinstance(piece, Windows) and piece.first < piece.last:
        return [leaf for half in piece.halves() for leaf in windows_of(half)]
    return [piece]


def test_setpoints_of_a_branch_are_those_the_robot_server_sends():
    dq = np.array([0.01, -0.02])
    cycles = brake_cycles(dq, np.array([0.003, 0.003]))
    sent = np.array([0.5, 0.5]) + np.cumsum([brake_increment(dq, cycles, k) for k in range(cycles)], axis=0)
    np.testing.assert_allclose(Branch(dq, cycles, -1).setpoints(np.array([0.5, 0.5])), sent, atol=1e-15)
    np.testing.assert_allclose(Branch(dq, cycles, 2).setpoints(sent[2]), sent[3:], atol=1e-15)


def test_a_robot_at_rest_has_one_point_and_one_window():
    piece = tube(np.tile([1.0, 2.0], (LAG, 1)), Branch(np.zeros(2), 1, 1), exact_drives(LAG))
    np.testing.assert_array_equal(piece.span().middle, [1.0, 2.0])
    np.testing.assert_array_equal(piece.span().half, [0.0, 0.0])
    assert piece.first == piece.last


@pytest.mark.parametrize("measured", [None, np.array([0.1, 0.2])])
def test_windows_begin_now_and_end_when_the_drives_reach_the_last_setpoint(measured):
    history, cycles = np.tile([1.0, 2.0], (LAG, 1)), 3
    past = LAG if measured is None else LAG + 1
    still = tube(
        history, Branch(np.zeros(2), 1, 1), exact_drives(LAG), None if measured is None else history[0]
    )
    assert (still.first, still.last) == (past - 1, past - 1)
    moving = tube(history, Branch(np.full(2, 0.01), cycles, -1), exact_drives(LAG), measured)
    assert (moving.first, moving.last) == (past - 1, past + cycles - 1 + LAG)


def test_a_single_window_and_windows_along_one_line_are_divided_as_their_span():
    around_a_corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.1]])
    line = np.linspace([0.0, 0.0], [1.0, 2.0], 9)
    for windows in (Windows(around_a_corner, exact_drives(2), 2, 2), Windows(line, exact_drives(2), 2, 8)):
        assert [type(half) for half in windows.halves()] == [Span, Span]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_span_and_its_halves_contain_every_mean_of_its_points(seed):
    random = np.random.default_rng(seed)
    points = np.cumsum(random.normal(size=(random.integers(1, 12), 3)) * random.uniform(0, 1, 3), axis=0)
    pieces = [Span.around(points, np.zeros(points.shape[1]), 0.0)]
    for _ in range(4):
        for weights in random.dirichlet(np.full(len(points), 0.3), size=10):
            q = weights @ points
            holding = [piece for piece in pieces if is_inside(piece, q, 1e-7)]
            assert holding
            assert all(np.all(np.abs(q - piece.middle) <= piece.half + 1e-6) for piece in holding)
        pieces = [half for piece in pieces for half in piece.halves() or (piece,)]


def test_the_span_of_points_on_a_line_is_the_line():
    span = Span.around(np.array([[0.0, 1.0], [0.5, 0.75], [2.0, 0.0]]), np.zeros(2), 0.0)
    np.testing.assert_allclose(span.deviation, 0.0, atol=1e-15)
    np.testing.assert_allclose(span.offsets, [[-1.0, 0.5], [1.0, -0.5]])
    np.testing.assert_allclose(span.middle, [1.0, 0.5])
    assert span.is_straight
    assert not Span.around(np.array([[0.0, 1.0], [0.5, 0.7], [2.0, 0.0]]), np.zeros(2), 0.0).is_straight


def test_in_each_half_the_midpoint_replaces_one_of_the_farthest_vertices():
    triangle = np.array([[0.0, 0.0], [4.0, 0.0], [1.0, 2.0]])
    first, second = Span(np.zeros(2), np.array([4.0, 2.0]), triangle, np.array([0.0, 0.1])).halves()
    np.testing.assert_allclose(first.middle + first.offsets, [[0.0, 0.0], [2.0, 0.0], [1.0, 2.0]])
    np.testing.assert_allclose(second.middle + second.offsets, [[2.0, 0.0], [4.0, 0.0], [1.0, 2.0]])
    for half, middle in ((first, [1.0, 1.0]), (second, [2.5, 1.0])):
        np.testing.assert_array_equal(half.deviation, [0.0, 0.1])
        np.testing.assert_allclose(half.middle, middle)
    np.testing.assert_allclose([first.half, second.half], [[1.0, 1.1], [1.5, 1.1]])


def test_division_ends_at_the_resolution_of_drives_and_at_spans_as_wide_as_long():
    def line(half, deviation):
        offsets = np.array([np.full(2, -half), np.full(2, half)])
        return Span(np.zeros(2), np.full(2, half + deviation), offsets, np.full(2, deviation))

    assert line(1e-8, 0.0).halves() == ()
    assert line(1e-3, 1.1e-3).halves() == ()
    assert len(line(1e-3, 0.9e-3).halves()) == 2
    assert len(line(1e-3, 0.0).halves()) == 2
    assert Span.around(np.ones((3, 2)), np.zeros(2), 0.0).halves() == ()


MAX_DV = np.array([0.0016, 0.0007, 0.003])
"""Of three joints [rad]; the emulated drives below follow a quarter of it with less overshoot than the tolerance."""


def spread_drives(dead_times_s, damping=1.0):
    """Drives of joints whose dead times rise evenly from the first to the last."""
    lag = ServoLag(dead_time_s=dead_times_s[0], natural_frequency_rad_s=167.0, damping=damping)
    kind = type("Spread", (SpreadServo,), {"spread_s": dead_times_s[-1] - dead_times_s[0]})
    return kind(np.zeros(len(dead_times_s)), lag, CYCLE_S)


@pytest.mark.long
@pytest.mark.parametrize(
    ("lag_s", "dead_times_s", "damping"),
    [
        (0.072, (0.012, 0.012, 0.012), 1.0),
        (0.072, (0.012, 0.012, 0.012), 0.5),
        (0.12, (0.048, 0.054, 0.06), 1.0),
        (0.156, (0.06, 0.078, 0.096), 1.0),
        (0.156, (0.06, 0.078, 0.096), 0.5),
    ],
)
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_emulated_drives_never_leave_the_windows_while_they_brake(lag_s, dead_times_s, damping, seed):
    """A robot on a random course is starved; each place of its drives is where it is checked and what is certified."""
    random = np.random.default_rng(seed)
    n, max_dv = 3, MAX_DV if damping == 1.0 else MAX_DV / 4
    spread = (max(dead_times_s) - min(dead_times_s)) / CYCLE_S / 2
    drives = DriveBounds(round(lag_s / CYCLE_S), np.full(n, np.deg2rad(0.05)), spread)
    plant, q_cmd, dq = spread_drives(dead_times_s, damping), np.zeros(n), np.zeros(n)
    history = History(drives.lag)
    for _ in range(int(random.integers(drives.lag + 1, 60))):
        dq = np.clip(dq + random.uniform(-1, 1, n) * max_dv, -0.03, 0.03)
        q_cmd = q_cmd + dq
        history.sent(q_cmd)
        # the telegram of a cycle comes before its setpoint takes effect
        assert is_on_hull(history, plant.q, drives)
        plant.advance(q_cmd)
    cycles = brake_cycles(dq, max_dv)
    piece = tube(history.array(), Branch(dq, cycles, 0), drives)
    spans = [leaf.span() for leaf in windows_of(piece)]
    for step in range(1, cycles + 3 * drives.lag):
        q_cmd = q_cmd + brake_increment(dq, cycles, step)
        history.sent(q_cmd)
        assert is_on_hull(history, plant.q, drives)
        assert any(is_inside(span, plant.q, 1e-9) for span in spans), step
        plant.advance(q_cmd)


def is_on_hull(history, q, drives):
    """Whether drives are as near to the hull of their setpoints as is certified."""
    points = history.array()
    width = widths(points, drives.tolerance, drives.spread)
    return not history.is_full or bool((np.abs(off_hull(points, q, width)) <= width).all())


def test_windows_for_equal_lags_do_not_contain_drives_with_different_lags():
    plant, history = spread_drives((0.012, 0.06)), History(7)
    for cycle in range(30):
        history.sent(np.array([0.03, 0.03]) * cycle)
        q = plant.q
        plant.advance(history.newest)
    alike = exact_drives(7, 2, np.deg2rad(0.05))
    assert (q >= history.array().min(axis=0)).all()
    assert (q <= history.array().max(axis=0)).all()
    assert not is_on_hull(history, q, alike)
    assert is_on_hull(history, q, replace(alike, spread=2.0))


# The courses a robot may take, setpoint by setpoint, and the tube around one, window by window.

HERE = np.array([1.0, 2.0])
DQ = np.array([0.4, -0.8])
SHORT_LAG = 3


DRIVES = exact_drives(SHORT_LAG)


def rising(count):
    """The last setpoints of a robot that came along a diagonal."""
    return np.array([HERE - 0.1 * k for k in reversed(range(count))])


@pytest.mark.parametrize(
    ("step", "shares"),
    [(-1, [1.0, 1.75, 2.25, 2.5]), (0, [0.75, 1.25, 1.5]), (1, [0.5, 0.75]), (2, [0.25]), (3, []), (9, [])],
)
def test_a_branch_continues_with_unsent_setpoints(step, shares):
    setpoints = Branch(DQ, 4, step).setpoints(HERE)
    assert setpoints.shape == (len(shares), 2)
    np.testing.assert_allclose(setpoints, [HERE + share * DQ for share in shares] if shares else setpoints)


def test_a_branch_without_motion_has_no_setpoints_to_come():
    assert Branch(np.zeros(2), 4, -1).setpoints(HERE).shape == (0, 2)
    assert len(Branch(np.array([0.0, 0.1]), 4, -1).setpoints(HERE)) == 4


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_branch_after_admissions_in_flight_continues_from_their_end(count):
    path = tuple(HERE + np.array([0.1, -0.1]) * k for k in range(1, 1 + count))
    to_come = [path[-1] + DQ, path[-1] + 1.5 * DQ]
    np.testing.assert_allclose(Branch(DQ, 2, -1, path).setpoints(HERE), [*path, *to_come])
    np.testing.assert_allclose(Branch(np.zeros(2), 2, -1, path).setpoints(HERE), path)


def test_a_tube_contains_the_last_and_the_future_setpoints():
    piece = tube(rising(3), Branch(DQ, 2, -1), DRIVES)
    np.testing.assert_allclose(piece.points, [*rising(3), HERE + DQ, HERE + 1.5 * DQ])
    assert piece.drives.lag == SHORT_LAG
    assert (piece.first, piece.last) == (2, 4 + SHORT_LAG)


def test_an_unexplained_measurement_comes_first_in_its_tube():
    measured = np.array([5.0, 5.0])
    piece = tube(rising(3), Branch(DQ, 2, -1), DRIVES, measured)
    np.testing.assert_allclose(piece.points[:2], [measured, rising(3)[0]])
    assert (piece.first, piece.last) == (3, 5 + SHORT_LAG)


def test_settling_drives_have_several_windows_and_a_robot_at_rest_has_one():
    settling = tube(rising(3), Branch(np.zeros(2), 1, 0), DRIVES)
    assert (settling.first, settling.last) == (2, 2 + SHORT_LAG)
    one_joint = tube(np.array([[1.0, 1.9], [1.0, 2.0]]), Branch(np.zeros(2), 1, 0), DRIVES)
    assert (one_joint.first, one_joint.last) == (1, 1 + SHORT_LAG)
    at_rest = tube(np.tile(HERE, (3, 1)), Branch(np.zeros(2), 1, 0), DRIVES)
    assert (at_rest.first, at_rest.last) == (2, 2)


LINE = np.arange(10)[:, None] * np.array([0.1, 0.2])
BENT = LINE + np.array([[0.0, 0.0], [0.0, 0.05]] * 5)
"""Setpoints beside one another, along no line."""


def ends(piece):
    """First and last setpoint, counted along the line, of what a piece holds."""
    span = piece.span()
    return pytest.approx([(span.middle[0] - span.half[0]) / 0.1, (span.middle[0] + span.half[0]) / 0.1])


@pytest.mark.parametrize(
    ("first", "last", "held"),
    [
        (0, 0, (0, 0)),
        (1, 1, (0, 1)),
        (5, 5, (3, 5)),
        (4, 7, (2, 7)),
        (10, 10, (8, 9)),
        (11, 11, (9, 9)),
        (30, 30, (9, 9)),
    ],
)
def test_a_window_contains_its_setpoint_and_those_of_the_lag_before(first, last, held):
    assert ends(Windows(LINE, exact_drives(2), first, last)) == list(held)


@pytest.mark.parametrize(
    ("last", "halves"), [(7, [(4, 5), (6, 7)]), (6, [(4, 5), (6, 6)]), (5, [(4, 4), (5, 5)])]
)
def test_windows_are_halved_so_that_each_is_in_one_half(last, halves):
    assert [(half.first, half.last) for half in Windows(BENT, exact_drives(2), 4, last).halves()] == halves


def test_windows_along_one_line_are_halved_as_the_line():
    left, right = Windows(LINE, exact_drives(2), 4, 7).halves()
    assert (ends(left), ends(right)) == ([2, 4.5], [4.5, 7])


def test_a_single_window_is_halved_along_its_line():
    left, right = Windows(LINE, exact_drives(2), 5, 5).halves()
    assert ends(left) == [3, 4]
    assert ends(right) == [4, 5]


def test_a_robot_with_one_state_is_at_that_state():
    piece = tube(HERE[None], Branch(np.zeros(2), 1, 0), DRIVES)
    assert (len(piece.points), piece.first, piece.last) == (1, 0, 0)
