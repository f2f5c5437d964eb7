"""The table of phases."""

import itertools

from deltaq_protocol.messages import Phase
from deltaq_services.phases import MAY_MOVE, TRANSITIONS, Event, next_phase


def test_each_phase_and_event_has_at_most_one_row():
    rows = [(row.phase, row.event) for row in TRANSITIONS]
    assert len(rows) == len(set(rows))


def test_held_is_left_by_reset_only():
    for event in Event:
        left = next_phase(Phase.HELD, event) is not Phase.HELD
        assert left == (event is Event.RESET)


def test_a_stop_holds_from_every_phase_that_may_move():
    assert all(next_phase(phase, Event.STOPPED) is Phase.HELD for phase in MAY_MOVE)


def test_every_phase_can_be_reached_from_offline():
    reached = {Phase.OFFLINE}
    for _ in Phase:
        reached |= {next_phase(phase, event) for phase, event in itertools.product(reached, Event)}
    assert reached == set(Phase)


def test_offline_never_moves():
    assert next_phase(Phase.OFFLINE, Event.ADMITTED) is Phase.OFFLINE
