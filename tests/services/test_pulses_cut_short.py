"""Setpoints with the pulse of a probe and without it, by the sessions in which they were sent."""

import numpy as np
from remembered import remembered

from deltaq_services.robot_server.mode_probe import SESSIONS, PulsesCutShort


def place(value):
    return np.full(2, float(value))


def cut(pulses, value, pulse=0.5):
    pulses.sent(place(value) + pulse, place(value))
    pulses.cut_short()
    return pulses


def test_what_was_sent_in_a_session_that_goes_on_is_not_looked_for():
    pulses = PulsesCutShort()
    pulses.sent(place(1.5), place(1))
    np.testing.assert_array_equal(pulses.undone(place(1.5)), place(1.5))
    pulses.cut_short()
    np.testing.assert_array_equal(pulses.undone(place(1.5)), place(1))
    pulses.cut_short()  # a session in which nothing was sent
    np.testing.assert_array_equal(pulses.undone(place(1.5)), place(1))


def test_every_joint_has_to_be_where_it_was_sent_but_for_rounding():
    pulses = cut(PulsesCutShort(), 0)
    np.testing.assert_array_equal(pulses.undone(place(0.5) + 1e-12), place(0))
    for off in ([1e-6, 0.0], [0.0, -1e-6]):
        np.testing.assert_array_equal(pulses.undone(place(0.5) + off), place(0.5) + off)
    exactly = cut(PulsesCutShort(), 0.0, pulse=0.0)
    np.testing.assert_array_equal(exactly.undone(place(1e-9)), place(0))


def test_of_two_sessions_that_were_sent_to_one_place_the_later_counts():
    pulses = cut(cut(PulsesCutShort(), 0, pulse=1.0), 0.25, pulse=0.75)
    np.testing.assert_array_equal(pulses.undone(place(1)), place(0.25))


def test_as_many_sessions_are_remembered_as_a_driver_does_and_another_goes_on_with_them():
    pulses = PulsesCutShort()
    for number in range(SESSIONS + 1):
        cut(pulses, number)
    pulses.sent(place(1000.5), place(1000))
    heir = PulsesCutShort()
    heir.restore(pulses.snapshot())
    assert remembered(heir) == remembered(pulses)
    heir.cut_short()
    np.testing.assert_array_equal(heir.undone(place(1000.5)), place(1000))
    for lost in (0, 1):
        np.testing.assert_array_equal(heir.undone(place(lost + 0.5)), place(lost + 0.5))
    np.testing.assert_array_equal(heir.undone(place(2.5)), place(2))
