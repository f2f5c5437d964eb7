"""The courses a robot may take, setpoint by setpoint, and the tube around one, window by window."""

import numpy as np
import pytest
from spans import exact_drives

from deltaq_services.sim.tube import Branch, Windows, tube

HERE = np.array([1.0, 2.0])
DQ = np.array([0.4, -0.8])
LAG = 3


DRIVES = exact_drives(LAG)


def rising(count):
    """The last setpoints of a robot that came along a diagonal."""
    return np.array([HERE - 0.1 * k for k in reversed(range(count))])


@pytest.mark.parametrize(
    ("step", "shares"),
    [(-1, [1.0, 1.75, 2.25, 2.5]), (0, [0.75, 1.25, 1.5]), (1, [0.5, 0.75]), (2, [0.25]), (3, []), (9, [])],
)
def test_a_branch_goes_on_with_what_was_not_sent_yet(step, shares):
    setpoints = Branch(DQ, 4, step).setpoints(HERE)
    assert setpoints.shape == (len(shares), 2)
    np.testing.assert_allclose(setpoints, [HERE + share * DQ for share in shares] if shares else setpoints)


def test_a_branch_without_motion_has_no_setpoints_to_come():
    assert Branch(np.zeros(2), 4, -1).setpoints(HERE).shape == (0, 2)
    assert len(Branch(np.array([0.0, 0.1]), 4, -1).setpoints(HERE)) == 4


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_branch_behind_what_is_in_flight_goes_on_from_the_end_of_that(count):
    path = tuple(HERE + np.array([0.1, -0.1]) * k for k in range(1, 1 + count))
    to_come = [path[-1] + DQ, path[-1] + 1.5 * DQ]
    np.testing.assert_allclose(Branch(DQ, 2, -1, path).setpoints(HERE), [*path, *to_come])
    np.testing.assert_allclose(Branch(np.zeros(2), 2, -1, path).setpoints(HERE), path)


def test_a_tube_holds_the_last_setpoints_and_those_to_come():
    piece = tube(rising(3), Branch(DQ, 2, -1), DRIVES)
    np.testing.assert_allclose(piece.points, [*rising(3), HERE + DQ, HERE + 1.5 * DQ])
    assert piece.drives.lag == LAG


def test_a_tube_reaches_from_the_present_window_to_the_one_in_which_the_drives_have_settled():
    piece = tube(rising(3), Branch(DQ, 2, -1), DRIVES)
    assert (piece.first, piece.last) == (2, 4 + LAG)


def test_where_the_robot_is_comes_first_in_a_tube_that_its_setpoints_do_not_explain():
    measured = np.array([5.0, 5.0])
    piece = tube(rising(3), Branch(DQ, 2, -1), DRIVES, measured)
    np.testing.assert_allclose(piece.points[:2], [measured, rising(3)[0]])
    assert (piece.first, piece.last) == (3, 5 + LAG)


def test_drives_that_still_settle_have_windows_to_come_and_a_robot_at_rest_has_one():
    settling = tube(rising(3), Branch(np.zeros(2), 1, 0), DRIVES)
    assert (settling.first, settling.last) == (2, 2 + LAG)
    one_joint = tube(np.array([[1.0, 1.9], [1.0, 2.0]]), Branch(np.zeros(2), 1, 0), DRIVES)
    assert (one_joint.first, one_joint.last) == (1, 1 + LAG)
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
def test_a_window_holds_its_setpoint_and_as_many_before_it_as_the_drives_lag(first, last, held):
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


def test_a_robot_that_was_heard_once_is_where_it_said():
    piece = tube(HERE[None], Branch(np.zeros(2), 1, 0), DRIVES)
    assert (len(piece.points), piece.first, piece.last) == (1, 0, 0)
