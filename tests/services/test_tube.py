"""The tube holds every configuration a lagging robot can be in."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from deltaq_cell.description import ServoLag
from deltaq_emulator.servo import Servo
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_services.sim.tube import Branch, Segment, Windows, tube

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
    piece = tube(np.tile([1.0, 2.0], (LAG, 1)), Branch(np.zeros(2), 1, 1), LAG)
    middle, half = piece.box()
    np.testing.assert_array_equal(middle, [1.0, 2.0])
    np.testing.assert_array_equal(half, [0.0, 0.0])
    assert piece.first == piece.last


def test_the_halves_of_a_segment_are_the_segment_and_end_at_what_no_drive_resolves():
    segment = Segment(np.array([0.0, 1.0]), np.array([2.0, 0.0]))
    left, right = segment.halves()
    np.testing.assert_array_equal(left.start, segment.start)
    np.testing.assert_array_equal(left.end, right.start)
    np.testing.assert_array_equal(right.end, segment.end)
    assert Segment(np.zeros(2), np.full(2, 1e-8)).halves() == ()


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
    boxes = [leaf.box() for leaf in windows_of(piece)]
    # the part of a second-order lag that is older than the window
    tail = 0.02 * np.ptp(np.array([*history, servo.q]), axis=0) + 1e-9
    for step in range(1, cycles + 3 * LAG):
        q_cmd = q_cmd + brake_increment(dq, cycles, step)
        servo.advance(q_cmd)
        inside = [np.all(np.abs(servo.q - middle) <= half + tail) for middle, half in boxes]
        assert any(inside), step


def test_a_single_window_on_a_line_is_divided_and_one_around_a_corner_is_not():
    straight = Windows(np.array([[0.0, 0.0], [0.1, 0.2], [0.2, 0.4]]), 2, 2, 2)
    assert len(straight.halves()) == 2
    corner = Windows(np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.4]]), 2, 2, 2)
    assert corner.halves() == ()
