"""How a Robot Server's process ends: the robot comes to rest first, and its KRC is told to end the motion."""

import signal

import pytest
from krc_side import KrcSide

from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.robot_server.core import Ending

SIGNALS = (signal.SIGTERM, signal.SIGINT)


@pytest.fixture
def krc():
    """A KRC whose robot moves; the process takes no signal but by the ending under test."""
    before = [signal.signal(number, signal.SIG_IGN) for number in SIGNALS]
    yield KrcSide().begin().run_up(4)
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)


def cycle(krc, ending):
    """One cycle of a KRC that is answered; whether its answer carries the stop."""
    krc.cycle()
    stop = ending.stop
    ending.cycle_passed()
    return stop


def ask(number):
    """Ask the process to end; the first time it must not end at once."""
    try:
        signal.raise_signal(number)
    except KeyboardInterrupt:
        pytest.fail("the first signal ended the process at once")


def test_without_a_signal_the_server_continues_with_and_without_its_krc(krc):
    ending = Ending(krc.server)
    assert (ending.stop, ending.over) == (False, False)
    for _ in range(100):
        assert not cycle(krc, ending)
        assert not ending.over
    ending.krc_silent()
    assert ending.over is False
    assert krc.server.state.phase is Phase.READY


@pytest.mark.parametrize("number", SIGNALS)
def test_on_a_signal_it_rests_first_and_then_sends_the_stop_three_times(krc, number):
    ending = Ending(krc.server)
    ask(number)
    stops = []
    while not ending.over:
        was_at_rest = krc.server.at_rest
        stops.append(cycle(krc, ending))
        assert not stops[-1] or was_at_rest
        assert len(stops) < 100
    assert sum(stops) == 3
    assert all(stops[-3:])
    state = krc.server.state
    assert (state.phase, state.reason) == (Phase.HELD, ReasonCode.SERVER_ENDED)
    assert not any(state.dq)


def test_in_a_new_session_the_stops_are_sent_after_rest(krc):
    ending = Ending(krc.server)
    ask(signal.SIGTERM)
    while not ending.stop:
        cycle(krc, ending)
        assert krc.time_s < 10
    krc.tick(100)
    krc.ipoc += 12 * 5000  # the KRC begins a session anew
    while krc.server.at_rest:
        krc.cycle()
        assert krc.time_s < 10
    ending.cycle_passed()
    assert not ending.stop
    assert not ending.over
    while not ending.over:
        cycle(krc, ending)
        assert krc.time_s < 10
    assert ending.stop


def test_on_a_signal_with_a_silent_krc_it_ends_at_once(krc):
    ending = Ending(krc.server)
    ask(signal.SIGTERM)
    assert not ending.over
    ending.krc_silent()
    assert ending.over


def test_on_a_second_signal_it_ends_at_once(krc):
    Ending(krc.server)
    ask(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
