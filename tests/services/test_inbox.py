"""Which request of a robot is decided, on which state, and what is said to the others."""

import pytest
from small_cell import server_state

from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import Phase, Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.inbox import Inbox

HERE = 100
"""The cycle of the newest state."""


def request(cycle=HERE, seq=1, lease_epoch=3, dq=(0.0,) * 6):
    return Request(robot="fr", cycle=cycle, lease_epoch=lease_epoch, seq=seq, dq=dq)


def state(cycle=HERE, phase=Phase.READY):
    return server_state("fr", cycle, phase)


@pytest.fixture
def inbox():
    return Inbox(joints=6, max_age_cycles=10)


def holding(inbox, **fields):
    inbox.put(request(**fields), HERE)
    return inbox


def test_the_first_request_of_all_is_valid_whatever_its_number(inbox):
    assert inbox.fault(request(seq=0, lease_epoch=0)) is None


@pytest.mark.parametrize(("dq", "count"), [((0.0,) * 5, 5), ((0.0,) * 7, 7), (None, 0)])
def test_a_wrong_number_of_joints_is_told_with_the_right_one(inbox, dq, count):
    told = Reason(code=ReasonCode.BAD_SHAPE, what="dq", value=count, bound=6)
    assert inbox.fault(request(dq=dq)) == told


def test_a_lease_that_was_followed_by_another_is_told_with_the_present_one(inbox):
    told = Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease_epoch", value=2, bound=3)
    assert holding(inbox, lease_epoch=3).fault(request(lease_epoch=2, seq=9)) == told


@pytest.mark.parametrize("seq", [4, 5])
def test_a_sequence_number_counts_once_and_is_told_with_the_newest(inbox, seq):
    told = Reason(code=ReasonCode.REPLAYED_SEQUENCE, what="seq", value=seq, bound=5)
    assert holding(inbox, seq=5).fault(request(seq=seq)) == told


def test_the_next_number_and_a_newer_lease_are_valid(inbox):
    holding(inbox, seq=5)
    assert inbox.fault(request(seq=6)) is None
    assert inbox.fault(request(seq=0, lease_epoch=4)) is None


def test_a_newer_request_replaces_the_one_that_waits(inbox):
    first, second = request(seq=1), request(seq=2)
    assert inbox.put(first, HERE) is None
    assert inbox.put(second, HERE) is first
    assert inbox.take() is second
    assert inbox.take() is None


@pytest.mark.parametrize(("ahead", "due"), [(-50, True), (0, True), (1, False), (2, False), (3, True)])
def test_a_request_that_overtook_its_state_by_little_waits_for_it(inbox, ahead, due):
    assert holding(inbox, cycle=HERE + ahead).due(state()) is due


def test_nothing_is_due_without_a_request_or_on_a_state_that_was_decided(inbox):
    assert not inbox.due(state())
    holding(inbox)
    inbox.decided_cycle = HERE
    assert not inbox.due(state())


def test_what_is_in_hand_is_due_once_the_hli_has_spoken_in_that_cycle(inbox):
    holding(inbox).decided_cycle = HERE
    assert inbox.cycle_passed(HERE + 1, missed=False) is None
    assert not inbox.due(state(HERE + 1))
    assert inbox.heartbeat(request(dq=None), HERE + 1) is None  # said before that state came
    assert not inbox.due(state(HERE + 1))
    assert inbox.heartbeat(request(HERE + 1, dq=None), HERE + 1) is None
    assert inbox.due(state(HERE + 1))


def test_a_heartbeat_may_overtake_its_state_and_one_from_far_off_says_nothing(inbox):
    holding(inbox).decided_cycle = HERE
    assert inbox.heartbeat(request(HERE + 50, lease_epoch=9, dq=None), HERE) is None
    inbox.cycle_passed(HERE + 1, missed=False)
    assert not inbox.due(state(HERE + 1))
    holding(inbox, seq=2)
    inbox.heartbeat(request(HERE + 1, dq=None), HERE)
    assert inbox.due(state(HERE + 1))


def test_by_two_cycles_a_heartbeat_may_overtake_its_state(inbox):
    holding(inbox, cycle=HERE + 2)
    inbox.spoken_cycle = HERE
    inbox.heartbeat(request(HERE + 2, lease_epoch=3, dq=None), HERE)
    assert inbox.due(state(HERE + 2))


def test_what_overtook_its_state_is_due_as_soon_as_that_has_come(inbox):
    holding(inbox, cycle=HERE + 2)
    inbox.cycle_passed(HERE + 1, missed=False)
    assert not inbox.due(state(HERE + 1))
    inbox.cycle_passed(HERE + 2, missed=False)
    assert inbox.due(state(HERE + 2))


def test_that_the_hli_has_spoken_in_a_cycle_is_not_forgotten_for_what_came_before(inbox):
    inbox.heartbeat(request(HERE + 1, dq=None), HERE)
    holding(inbox).decided_cycle = HERE
    inbox.cycle_passed(HERE + 1, missed=False)
    assert inbox.due(state(HERE + 1))


def test_a_request_from_far_off_does_not_speak_for_the_cycles_until_then(inbox):
    holding(inbox, cycle=HERE + 50, seq=1).take()
    holding(inbox, seq=2).decided_cycle = HERE
    inbox.cycle_passed(HERE + 1, missed=False)
    assert not inbox.due(state(HERE + 1))


def test_what_waited_in_the_hli_for_a_state_waits_for_it_here_too(inbox):
    inbox.put(request(seq=1).model_copy(update={"newest": HERE + 1}), HERE)
    assert not inbox.due(state())
    inbox.cycle_passed(HERE + 1, missed=False)
    assert inbox.due(state(HERE + 1))


def test_a_heartbeat_of_another_lease_takes_what_waits_away(inbox):
    waiting = request()
    inbox.put(waiting, HERE)
    assert inbox.heartbeat(request(lease_epoch=0, dq=None), HERE) is waiting
    assert inbox.waiting is None


def test_what_answers_a_state_older_than_the_one_before_is_in_hand_no_more(inbox):
    late = request()
    inbox.put(late, HERE)
    assert inbox.cycle_passed(HERE + 1, missed=False) is None
    assert inbox.cycle_passed(HERE + 2, missed=False) is late
    assert inbox.waiting is None


@pytest.mark.parametrize(
    ("answers", "missed", "comes_back"), [(HERE, True, True), (HERE, False, False), (HERE - 1, True, False)]
)
def test_a_request_comes_back_if_its_admission_was_missed_and_it_is_late_by_one_cycle_only(
    inbox, answers, missed, comes_back
):
    decided = inbox.decided = request(answers)
    assert inbox.cycle_passed(HERE + 1, missed) is None
    assert inbox.waiting is (decided if comes_back else None)
    assert inbox.decided is None


def test_a_request_does_not_come_back_past_a_newer_one_another_lease_or_what_forgets_it(inbox):
    def missed():
        inbox.cycle_passed(HERE + 1, missed=True)
        return inbox.waiting

    newer = request(seq=2)
    inbox.decided = request()
    inbox.put(newer, HERE)
    assert missed() is newer
    assert inbox.forget() is newer
    inbox.decided = request()
    inbox.heartbeat(request(lease_epoch=4, dq=None), HERE)
    assert missed() is None
    inbox.decided = request()
    assert inbox.forget() is None
    assert missed() is None
    inbox.decided = request()
    inbox.begin_anew()
    assert missed() is None


@pytest.mark.parametrize("cycle", [0, 1])
def test_even_the_first_states_of_all_are_decided(inbox, cycle):
    assert holding(inbox, cycle=cycle).due(state(cycle))


def test_a_request_for_a_cycle_that_is_far_off_is_told_the_present_one(inbox):
    told = Reason(code=ReasonCode.FUTURE_CYCLE, what="cycle", value=HERE + 3, bound=HERE)
    assert holding(inbox, cycle=HERE + 3).fault_on(state(), stopping=False) == told


def test_a_request_may_answer_a_state_of_the_greatest_age_and_none_older(inbox):
    assert holding(inbox, cycle=HERE - 10).fault_on(state(), stopping=False) is None
    told = Reason(code=ReasonCode.STALE_CYCLE, what="cycle", value=HERE - 11, bound=HERE - 10)
    assert holding(inbox, cycle=HERE - 11).fault_on(state(), stopping=False) == told


@pytest.mark.parametrize(
    ("phase", "stopping", "code"),
    [
        (Phase.OFFLINE, False, ReasonCode.NOT_READY),
        (Phase.HELD, False, ReasonCode.STOPPED),
        (Phase.READY, True, ReasonCode.STOPPED),
        (Phase.ENGAGED, True, ReasonCode.STOPPED),
    ],
)
def test_a_robot_that_may_not_move_says_why(inbox, phase, stopping, code):
    assert holding(inbox).fault_on(state(phase=phase), stopping) == Reason(code=code)


@pytest.mark.parametrize("phase", [Phase.READY, Phase.ENGAGED, Phase.BRAKING])
def test_a_robot_that_may_move_is_decided(inbox, phase):
    assert holding(inbox).fault_on(state(phase=phase), stopping=False) is None
