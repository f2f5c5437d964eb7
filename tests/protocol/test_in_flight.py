"""What is reckoned with that no state shows yet; `tests/testing/test_answering.py` holds it against real cores."""

from typing import Any

import pytest

from deltaq_protocol.in_flight import PATIENCE_CYCLES, InFlight
from deltaq_protocol.messages import Outcome, Phase, Playout, RobotState, ToolPose, Verdict


@pytest.fixture
def in_flight() -> InFlight:
    return InFlight()


POSE = ToolPose(position=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))


def state(cycle: int, q_cmd: float = 0.0, q_ahead: float | None = None, **changes: Any) -> RobotState:
    """A state of a robot with one joint, in a cell with a lookahead of 2 if it tells `q_ahead`."""
    ahead = {} if q_ahead is None else {"q_ahead": (q_ahead,), "setpoint_cycle": cycle + 2}
    fields: dict[str, Any] = {"robot": "fr", "cycle": cycle, "ipoc": 0, "time_s": 0.0, "q": (q_cmd,)}
    fields |= {"q_cmd": (q_cmd,), "tool": POSE, "phase": Phase.ENGAGED}
    return RobotState(**fields | ahead | changes)


def verdict(seq: int, cycle: int, dq: float, outcome: Outcome = Outcome.ADMITTED) -> Verdict:
    goes = None if outcome in (Outcome.REFUSED, Outcome.HELD, Outcome.CARRIED) else cycle
    return Verdict(robot="fr", cycle=cycle - 2, seq=seq, outcome=outcome, setpoint_cycle=goes, dq=(dq,))


def reckoned(in_flight: InFlight, told: RobotState) -> tuple[int, float]:
    ahead = in_flight.ahead(told)
    return ahead.cycle, pytest.approx(float(ahead.q_cmd[0]))


def test_a_verdict_on_an_unsent_increment_changes_nothing(in_flight: InFlight) -> None:
    assert not in_flight.take(verdict(7, 12, 0.1))
    assert reckoned(in_flight, state(10, 1.0, 1.5)) == (11, 1.5)


def test_an_increment_without_a_verdict_is_abandoned_and_counted_once(in_flight: InFlight) -> None:
    in_flight.ahead(state(10, 1.0, 1.5))
    in_flight.sent(1, [0.1], 10)
    last = 10 + 2 + PATIENCE_CYCLES
    assert reckoned(in_flight, state(last - 1, 1.0, 1.0)) == (last + 1, 1.1)
    assert in_flight.take_given_up() == 0
    assert reckoned(in_flight, state(last, 1.0, 1.0)) == (last + 1, 1.0)
    assert (in_flight.take_given_up(), in_flight.take_given_up()) == (1, 0)
    assert not in_flight.take(verdict(1, 12, 0.1))  # too late to be counted again


@pytest.mark.parametrize("outcome", [Outcome.REFUSED, Outcome.HELD])
def test_a_refused_increment_counts_as_in_flight_until_its_verdict(outcome: Outcome) -> None:
    in_flight = InFlight()
    in_flight.ahead(state(10, 1.0, 1.4))
    in_flight.sent(1, [0.1], 10)
    undecided = state(11, 1.0, 1.5, setpoint_cycle=12)
    assert reckoned(in_flight, undecided) == (12, 1.6)
    assert in_flight.take(verdict(1, 13, 0.0, outcome))
    assert reckoned(in_flight, undecided) == (11, 1.5)


def test_an_increment_shown_by_a_state_is_not_in_flight_without_its_verdict(in_flight: InFlight) -> None:
    in_flight.ahead(state(10, 1.0, 1.4))
    in_flight.sent(1, [0.1], 10)
    assert reckoned(in_flight, state(11, 1.0, 1.5)) == (12, 1.5)


@pytest.mark.parametrize("dq", [[float("nan")], [float("inf")], [0.1, 0.1], []])
def test_an_increment_of_the_wrong_shape_is_refused_and_not_in_flight(dq: list[float]) -> None:
    """Else one bad increment would make the next one bad, and that the one after."""
    in_flight = InFlight()
    in_flight.ahead(state(10, 1.0, 1.4))
    in_flight.sent(1, dq, 10)
    undecided = state(11, 1.0, 1.5, setpoint_cycle=12)
    assert reckoned(in_flight, undecided) == (11, 1.5)
    in_flight.sent(2, [0.1], 11)
    assert reckoned(in_flight, undecided) == (12, 1.6)


def test_a_scaled_increment_counts_as_admitted(in_flight: InFlight) -> None:
    in_flight.sent(1, [0.1], 10)
    in_flight.take(verdict(1, 13, 0.04, Outcome.SCALED))
    assert reckoned(in_flight, state(11, 1.0, 1.5)) == (13, 1.54)
    assert reckoned(in_flight, state(12, 1.0, 1.54)) == (13, 1.54)  # the state knows of it: not twice


def test_of_two_verdicts_on_one_increment_the_last_counts(in_flight: InFlight) -> None:
    in_flight.sent(1, [0.1], 10)
    assert in_flight.take(verdict(1, 12, 0.1))
    assert not in_flight.take(verdict(1, 14, 0.1))  # its admission came too late
    assert reckoned(in_flight, state(12, 1.0, 1.0)) == (14, 1.1)


def test_a_hold_clears_all_increments_in_flight(in_flight: InFlight) -> None:
    in_flight.sent(1, [0.1], 10)
    in_flight.sent(2, [0.1], 11)
    in_flight.take(verdict(1, 14, 0.1))
    assert reckoned(in_flight, state(11, 1.0, 1.0, phase=Phase.HELD)) == (11, 1.0)
    assert reckoned(in_flight, state(12, 1.0, 1.0)) == (13, 1.0)


def test_increments_before_an_admitted_one_count_as_requested(in_flight: InFlight) -> None:
    in_flight.ahead(state(10, 1.0, 1.4))
    in_flight.sent(1, [0.1], 10)
    in_flight.sent(2, [0.01], 11)
    in_flight.take(verdict(2, 13, 0.01))
    assert reckoned(in_flight, state(11, 1.0, 1.5, setpoint_cycle=12)) == (13, 1.61)
    in_flight.take(verdict(1, 12, 0.05, Outcome.SCALED))
    assert reckoned(in_flight, state(11, 1.0, 1.5, setpoint_cycle=12)) == (13, 1.56)


def test_a_held_setpoint_does_not_count_as_the_increment_behind_it(in_flight: InFlight) -> None:
    in_flight.ahead(state(10, 1.0, 1.4))
    in_flight.sent(1, [0.1], 10)
    held = Verdict(robot="fr", cycle=11, seq=1, outcome=Outcome.HELD, dq=(0.02,))
    in_flight.take(held)
    in_flight.sent(2, [0.01], 11)
    assert reckoned(in_flight, state(11, 1.0, 1.42)) == (13, 1.43)  # 12 is of the brake


def test_another_robot_server_counts_from_one(in_flight: InFlight) -> None:
    for seq, cycle in enumerate((1000, 1001), start=1):
        in_flight.ahead(state(cycle, 1.0, 1.5))
        in_flight.sent(seq, [0.1], cycle)
    assert reckoned(in_flight, state(1, 2.0, 2.0)) == (2, 2.0)
    assert in_flight.take_given_up() == 2
    assert list(in_flight.cycles_to_answer(state(2, 2.0, 2.0))) == [2]


def test_missed_states_are_answered_once_each_within_the_lookahead(in_flight: InFlight) -> None:
    assert list(in_flight.cycles_to_answer(state(10, 1.0, 1.1))) == [10]
    in_flight.sent(1, [0.1], 10)
    in_flight.take(verdict(1, 12, 0.1))
    used_up = state(15, 1.2, 1.2, setpoint_cycle=16)
    assert list(in_flight.cycles_to_answer(used_up)) == [14, 15]
    for seq, cycle in enumerate((14, 15), start=2):
        in_flight.sent(seq, [0.1], cycle)
    assert list(in_flight.cycles_to_answer(state(16, 1.2, 1.3))) == [16]


def test_a_robot_at_rest_gets_one_increment_at_a_time(in_flight: InFlight) -> None:
    in_flight.ahead(state(10, 1.0, 1.0))
    in_flight.sent(1, [0.1], 10)
    assert list(in_flight.cycles_to_answer(state(20, 1.0, 1.0))) == [20]


def test_without_a_lookahead_the_last_setpoint_and_its_successors_count(in_flight: InFlight) -> None:
    assert reckoned(in_flight, state(10, 1.0)) == (10, 1.0)
    in_flight.sent(1, [0.1], 10)
    assert reckoned(in_flight, state(11, 1.0)) == (12, 1.1)
    in_flight.take(verdict(1, 12, 0.05))
    assert reckoned(in_flight, state(11, 1.0)) == (12, 1.05)
    assert reckoned(in_flight, state(12, 1.05)) == (12, 1.05)


# --- with a playout buffer ------------------------------------------------------------------------


def played(cycle: int, q_cmd: float, answered: int | None, delay: int = 5) -> RobotState:
    """A state that has in it all increments up to the one that answers cycle `answered`."""
    return state(cycle, q_cmd, playout=Playout(delay_cycles=delay, waiting=0, answered_cycle=answered))


def test_with_a_jitter_buffer_increments_in_flight_count_without_verdicts(in_flight: InFlight) -> None:
    for seq, cycle in enumerate(range(10, 16), start=1):
        in_flight.sent(seq, [0.1 * seq], cycle)
    ahead = in_flight.ahead(played(16, 1.0, answered=None))
    assert (ahead.cycle, float(ahead.q_cmd[0])) == (21, pytest.approx(1.0 + 2.1))
    assert ahead.dq == pytest.approx([0.6])
    ahead = in_flight.ahead(played(17, 1.3, answered=11))
    assert (ahead.cycle, float(ahead.q_cmd[0])) == (22, pytest.approx(1.3 + 1.8))
    ahead = in_flight.ahead(played(21, 3.1, answered=15))
    assert (float(ahead.q_cmd[0]), ahead.dq) == (pytest.approx(3.1), None)


def test_with_a_jitter_buffer_a_refused_increment_no_longer_counts(in_flight: InFlight) -> None:
    in_flight.sent(1, [0.1], 10)
    in_flight.sent(2, [0.2], 11)
    assert in_flight.take(verdict(1, 10, 0.0, Outcome.REFUSED))
    assert reckoned(in_flight, played(12, 1.0, answered=9)) == (17, 1.2)


def test_with_a_jitter_buffer_a_lost_verdict_is_abandoned_after_its_cycle(in_flight: InFlight) -> None:
    in_flight.sent(1, [0.1], 10)
    in_flight.ahead(played(16, 1.0, answered=10 + PATIENCE_CYCLES - 1))
    assert in_flight.take_given_up() == 0
    in_flight.ahead(played(17, 1.0, answered=10 + PATIENCE_CYCLES))
    assert in_flight.take_given_up() == 1


def test_with_a_jitter_buffer_increments_that_are_never_played_out_expire(in_flight: InFlight) -> None:
    for cycle in range(1000):
        in_flight.ahead(played(cycle, 1.0, answered=None))
        in_flight.sent(cycle, [0.1], cycle)
    left = float(in_flight.ahead(played(1000, 1.0, answered=None)).q_cmd[0]) - 1.0
    assert left <= 0.1 * (2 * 5 + PATIENCE_CYCLES + 1)


def test_over_a_slow_link_only_a_few_missed_states_are_answered(in_flight: InFlight) -> None:
    assert list(in_flight.cycles_to_answer(played(10, 1.0, answered=None))) == [10]
    in_flight.sent(1, [0.1], 10)
    assert list(in_flight.cycles_to_answer(played(12, 1.0, answered=None))) == [11, 12]
    in_flight.sent(2, [0.1], 11)
    in_flight.sent(3, [0.1], 12)
    assert list(in_flight.cycles_to_answer(played(60, 1.0, answered=12))) == [56, 57, 58, 59, 60]


def test_with_a_jitter_buffer_deferred_motion_of_late_increments_counts_once(in_flight: InFlight) -> None:
    in_flight.sent(1, [0.1], 10)
    in_flight.sent(2, [0.2], 11)
    assert in_flight.take(verdict(1, 10, 0.0, Outcome.CARRIED))
    playout = Playout(delay_cycles=5, waiting=0, answered_cycle=10, owed=(0.03,))
    assert reckoned(in_flight, state(17, 1.0, playout=playout)) == (22, 1.23)
    before_its_turn_is_told = Playout(delay_cycles=5, waiting=0, answered_cycle=9, owed=(-0.04,))
    assert reckoned(in_flight, state(17, 1.0, playout=before_its_turn_is_told)) == (22, 1.26)
