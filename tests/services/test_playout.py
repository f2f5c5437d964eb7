"""Increments that wait for their turn: the buffer, and the HLI around it."""

import itertools
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from remembered import remembered
from small_cell import server_state, small_cell, told, tool_pose

from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import (
    EarlierIncrement,
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Outcome,
    Phase,
    RobotState,
    Sight,
    StopRequest,
    Verdict,
    ViewTarget,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.core import HliCore
from deltaq_services.hli.leases import Sequence
from deltaq_services.hli.playout import Asked, CarriedMotion, Fate, Left, PlayoutBuffer
from deltaq_services.outputs import Output, Sender, ToSender, ToTopic

DQ = (1e-5, 0.0, 0.0, 0.0, 0.0, 0.0)
MOST_CYCLES = 83
CYCLE_S = 0.012


def asked(cycle: int, came: int) -> Asked:
    return Asked(Increment(robot="fr", seq=cycle, cycle=cycle, dq=DQ), 1, None, came)


def new_buffer() -> PlayoutBuffer:
    return PlayoutBuffer(MOST_CYCLES, CarriedMotion(np.full(6, 0.01), np.full(6, 0.001)))


class Link:
    """A buffer, and increments that reach it some cycles after the state that they answer was published."""

    def __init__(self) -> None:
        self.buffer = new_buffer()
        self.cycle = 0
        self.played: list[tuple[int, int]] = []
        self.left: list[Left] = []

    @property
    def late(self) -> list[int]:
        return [one.asked.increment.cycle for one in self.left]

    def run(self, ages: list[int | None], missed: frozenset[int] = frozenset()) -> None:
        """Answer a state each cycle, under way for so many cycles, None: lost; then wait until all have come.

        Args:
            ages: of the answers to one state after another.
            missed: numbers of states that never came, from 1.
        """
        answered = {k: age for k, age in enumerate(ages, start=1) if age is not None and k not in missed}
        coming = {self.cycle + k: self.cycle + k + age for k, age in answered.items()}
        newest = self.cycle
        for now in range(self.cycle + 1, self.cycle + len(ages) + MOST_CYCLES + 2):
            if now - self.cycle not in missed:
                newest = now
                turn = self.buffer.turn(now)
                self.left += turn.left
                if turn.asked is not None:
                    self.played.append((now, turn.asked.increment.cycle))
            for cycle in (cycle for cycle, at in coming.items() if at == now):
                left = self.buffer.put(asked(cycle, newest), newest)
                self.left += [] if left is None else [left]
        self.cycle += len(ages) + MOST_CYCLES + 1


def delays(link: Link) -> set[int]:
    return {now - cycle for now, cycle in link.played}


def test_on_an_even_link_each_cycle_has_an_increment_with_the_least_delay() -> None:
    link = Link()
    link.run([5] * 300)
    assert delays(link) == {6}  # it came after the fifth state, and is passed on with the sixth
    assert len(link.played) == 300
    assert (link.buffer.told().late, link.buffer.told().empty) == (0, 0)


def test_the_report_has_the_increments_of_the_next_turns_up_to_the_first_gap() -> None:
    buffer, plan = new_buffer(), server_state().plan
    for cycle in range(1, 8):
        buffer.put(asked(cycle, cycle + 5), cycle + 5)  # five cycles under way: a delay of six
    buffer.put(asked(9, 14), 14)
    buffer.moved(11, plan)
    assert buffer.told().planned == (DQ,) * 3  # those of 5, 6 and 7; 8 is lost
    buffer.moved(14, plan)
    assert buffer.told().planned == ()
    buffer.moved(15, plan)
    assert buffer.told().planned == (DQ,)


def test_known_jitter_leaves_no_empty_cycle() -> None:
    link, draw = Link(), random.Random(3)
    ages: list[int | None] = [draw.choice((3, 4, 5, 6, 7)) for _ in range(1000)]
    link.run(ages)
    learning = 50
    known = [now - cycle for now, cycle in link.played if cycle > learning]
    assert set(known) == {8}
    assert sum(cycle > learning for cycle in link.late) == 0


def test_a_lost_increment_costs_its_own_cycle_and_no_other() -> None:
    link = Link()
    link.run([4] * 100 + [None] + [4] * 100)
    assert len(link.played) == 200
    assert link.buffer.told().empty == 1


@pytest.mark.parametrize(("age", "fate"), [(17, Fate.CARRIED), (18, Fate.LATE)])
def test_few_very_late_increments_do_not_raise_the_delay_and_are_deferred(age: int, fate: Fate) -> None:
    link = Link()
    link.run(([4] * 99 + [age]) * 5 + [4] * 40)
    assert max(delays(link)) <= 5
    assert [(one.fate, one.late_cycles) for one in link.left] == [(fate, age - 5)] * 5
    assert link.buffer.told().late == 5


def test_the_delay_follows_the_link_up_and_down() -> None:
    link = Link()
    link.run([3] * 300)
    link.run([20] * 300)
    assert link.buffer.told().delay_cycles == 21
    link.run([3] * 600)
    assert link.buffer.told().delay_cycles == 4


@pytest.mark.parametrize(("before", "delay_cycles"), [(18, 31), (19, 5)])
def test_one_of_twenty_may_be_late_and_none_of_fewer(before: int, delay_cycles: int) -> None:
    buffer = new_buffer()
    for cycle in range(before):
        buffer.put(asked(cycle, cycle + 4), cycle + 4)
    assert buffer.told().delay_cycles == 5
    buffer.put(asked(before, before + 30), before + 30)
    assert buffer.told().delay_cycles == delay_cycles


def test_a_second_answer_to_an_answered_state_is_late() -> None:
    buffer = new_buffer()
    buffer.put(asked(10, 10), 10)
    assert buffer.turn(11).asked is not None
    again = asked(10, 11)
    assert buffer.put(again, 11) == Left(again, Fate.SUPERSEDED, 0)
    assert buffer.told().late == 1


def test_of_two_answers_to_one_state_the_newer_is_kept() -> None:
    buffer = new_buffer()
    first, again = asked(10, 12), asked(10, 12)
    assert buffer.put(first, 12) is None
    assert buffer.put(again, 12) == Left(first, Fate.SUPERSEDED)
    assert buffer.turn(13).asked == again


def test_after_a_restart_of_the_robot_server_no_earlier_increment_passes() -> None:
    buffer = new_buffer()
    for cycle in (1000, 1001):
        buffer.put(asked(cycle, cycle), cycle)
        buffer.turn(cycle + 1)
    buffer.put(asked(1002, 1002), 1002)
    turn = buffer.turn(1)
    assert turn.asked is None
    assert [(one.asked.increment.cycle, one.fate) for one in turn.left] == [(1002, Fate.LATE)]
    told = buffer.told()
    assert (told.answered_cycle, told.late, told.waiting) == (None, 1, 0)
    buffer.put(asked(1, 1), 1)
    assert buffer.turn(2).asked == asked(1, 1)


def test_after_a_lost_state_the_newest_increment_passes_and_the_other_is_deferred() -> None:
    link = Link()
    link.run([4] * 60, missed=frozenset({30}))
    assert delays(link) == {5}
    assert link.late == [25]
    told = link.buffer.told()
    assert (told.late, told.empty, told.waiting) == (1, 2, 0)  # that state's own turn, and that of its answer


def test_the_report_begins_with_the_first_cycle() -> None:
    buffer = new_buffer()
    assert buffer.told().answered_cycle is None
    buffer.put(asked(0, 0), 0)
    assert buffer.turn(1).asked == asked(0, 0)
    assert buffer.told().answered_cycle == 0
    buffer.put(asked(3, 3), 3)
    buffer.turn(4)
    assert buffer.told().empty == 2


@pytest.mark.parametrize(("pause", "empty"), [(MOST_CYCLES, MOST_CYCLES), (MOST_CYCLES + 1, 0)])
def test_cycles_of_a_pause_do_not_count_as_empty(pause: int, empty: int) -> None:
    buffer = new_buffer()
    for cycle in (10, 11 + pause):
        buffer.put(asked(cycle, cycle), cycle)
        buffer.turn(cycle + 1)
    assert buffer.told().empty == empty


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.one_of(st.none(), st.integers(0, MOST_CYCLES)), min_size=1, max_size=120),
    st.frozensets(st.integers(1, 120), max_size=20),
)
def test_every_increment_passes_once_and_in_order_or_is_reported(
    ages: list[int | None], missed: frozenset[int]
) -> None:
    link = Link()
    link.run(ages, missed)
    order = [cycle for _, cycle in link.played]
    sent = {k for k, age in enumerate(ages, start=1) if age is not None and k not in missed}
    assert order == sorted(set(order))
    assert sorted([*order, *link.late]) == sorted(sent)
    assert all(0 < now - cycle <= MOST_CYCLES + 1 for now, cycle in link.played)
    told = link.buffer.told()
    assert (told.waiting, told.late) == (0, len(link.late))
    assert told.answered_cycle == (order[-1] if order else None)


@example([2, 3, 2], 3)
@example([1, 4, 2, 3, 2, 1, 5, 2, 3], 4)
@given(st.lists(st.integers(0, 12), min_size=4), st.integers(1, 7))
def test_no_sequence_number_is_accepted_twice_and_a_window_of_one_accepts_only_greater_ones(
    numbers: list[int], width: int
) -> None:
    sequence, only_greater, taken = Sequence(width), Sequence(), []
    newest = -1
    for number in numbers:
        is_new = sequence.take(number)
        assert is_new == (number not in taken and (number > newest or newest - number < width))
        assert only_greater.take(number) == (number > newest)
        taken += [number] if is_new else []
        newest = max(newest, number)
        assert sequence.seen >> width == 0, "no more is remembered than is told apart"
    assert sequence.newest == only_greater.newest == newest


# --- the HLI ----------------------------------------------------------------------------------------


class Client(Sender):
    lasting = True

    def deliver(self, message: Any) -> None:
        raise AssertionError("the core only hands it back")


class Bench:
    """An HLI that a client far away has a lease of."""

    def __init__(self, playout: bool = True) -> None:
        cell = small_cell(max_playout_s=0.6)
        tokens = (f"token-{k}" for k in itertools.count())
        self.core = HliCore(cell, told(cell), tool_pose, lambda: next(tokens), 1000)
        self.client, self.time_s, self.cycle = Client(), 50.0, 100
        self.core.on_server_state(server_state("fr", self.cycle), self.time_s)
        asked = LeaseRequest(robot="fr", action=LeaseAction.ACQUIRE, playout=playout)
        (reply,) = (one.message for one in self.core.requests.on_lease(asked, self.client, self.time_s))
        assert isinstance(reply, LeaseReply)
        self.lease = str(reply.lease)

    def turn(self, **changes: Any) -> tuple[Request, RobotState, list[Verdict]]:
        """The next cycle: what the gate is asked, what clients are told, and what is refused."""
        self.cycle, self.time_s = self.cycle + 1, self.time_s + CYCLE_S
        outputs = self.core.on_server_state(server_state("fr", self.cycle, **changes), self.time_s)
        messages = [one.message for one in outputs if isinstance(one, ToTopic)]
        (request,) = (one for one in messages if isinstance(one, Request))
        (state,) = (one for one in messages if isinstance(one, RobotState))
        return request, state, verdicts(outputs)

    def answer(self, cycle: int, seq: int, earlier: tuple[tuple[int, int], ...] = ()) -> list[Output]:
        sent = Increment(
            robot="fr",
            seq=seq,
            cycle=cycle,
            dq=DQ,
            lease=self.lease,
            earlier=tuple(EarlierIncrement(cycle=c, seq=s, dq=DQ) for c, s in earlier),
        )
        return self.core.increments.on_increment(sent, self.client, self.time_s)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def verdicts(outputs: list[Output]) -> list[Verdict]:
    return [one.message for one in outputs if isinstance(one, ToSender) and isinstance(one.message, Verdict)]


def test_an_increment_from_the_buffer_passes_with_the_present_cycle(bench: Bench) -> None:
    for _ in range(30):
        bench.turn()
    assert bench.answer(bench.cycle - 25, seq=1) == []
    request, state, refused = bench.turn()
    assert (request.seq, request.dq, refused) == (1, DQ, [])
    assert request.cycle == request.newest == bench.cycle, "the gate is not told the age, which is no fault"
    assert state.playout is not None
    assert state.playout.answered_cycle is None, "its setpoint does not have it yet"
    _, state, _ = bench.turn()
    assert state.playout is not None
    assert state.playout.answered_cycle == bench.cycle - 27


def test_reordered_increments_pass_in_the_order_of_their_states(bench: Bench) -> None:
    for seq, cycle in enumerate(range(101, 131), start=1):  # one that takes three cycles shows the delay
        bench.turn()
        if cycle == 101:
            late = cycle
        elif cycle == 104:
            bench.answer(late, seq=1)
            bench.answer(cycle, seq)
        else:
            bench.answer(cycle, seq)
    order = []
    for _ in range(10):
        request, _, _ = bench.turn()
        order += [request.seq] if request.dq is not None else []
    assert order == sorted(order)
    assert order[-1] == 30


def test_a_duplicate_is_refused_though_numbers_may_overtake_one_another(bench: Bench) -> None:
    bench.turn()
    assert bench.answer(101, seq=7) == []
    assert bench.answer(100, seq=6) == []
    for seq in (6, 7):
        (refused,) = verdicts(bench.answer(101, seq=seq))
        assert refused.reasons[0].code is ReasonCode.REPLAYED_SEQUENCE


def test_a_lost_increment_is_restored_from_its_successor(bench: Bench) -> None:
    for cycle in range(101, 105):
        bench.turn()
        bench.answer(cycle, cycle, earlier=((cycle - 1, cycle - 1),))
    bench.turn()  # the answer to 105 is lost
    bench.turn()
    assert bench.answer(106, 106, earlier=((104, 104), (105, 105))) == []
    passed_on = [bench.turn()[0].seq for _ in range(3)]
    assert passed_on[:2] == [105, 106]
    assert bench.core.counters["increments_repeated"] == 2, "that of 100, and that of 105"
    assert bench.core.counters["increments_overtaken"] == 0


def test_an_already_repeated_increment_is_accepted_as_no_duplicate_once(bench: Bench) -> None:
    for _ in range(2):
        bench.turn()
    assert bench.answer(102, 102, earlier=((101, 101),)) == []
    assert bench.answer(101, 101) == []
    assert bench.core.counters["increments_overtaken"] == 1
    (refused,) = verdicts(bench.answer(101, 101))
    assert refused.reasons[0].code is ReasonCode.REPLAYED_SEQUENCE


def test_repeated_increments_are_checked_and_answered_by_their_own_number(bench: Bench) -> None:
    for _ in range(80):
        bench.turn()
    (refused,) = verdicts(bench.answer(bench.cycle, 9, earlier=((bench.cycle - 51, 8),)))
    assert (refused.seq, refused.reasons[0].code) == (8, ReasonCode.LINK_TOO_SLOW)
    assert bench.turn()[0].seq == 9


def test_without_a_jitter_buffer_repeated_increments_are_ignored() -> None:
    bench = Bench(playout=False)
    bench.turn()
    bench.answer(bench.cycle, 7, earlier=((bench.cycle, 6),))
    assert bench.core.counters["increments"] == 1
    assert verdicts(bench.answer(bench.cycle, 6))[0].reasons[0].code is ReasonCode.REPLAYED_SEQUENCE


def test_a_too_slow_link_is_reported_with_its_delay_and_the_bound(bench: Bench) -> None:
    for _ in range(80):
        bench.turn()
    (refused,) = verdicts(bench.answer(bench.cycle - 51, seq=1))
    (reason,) = refused.reasons
    assert (reason.code, reason.what, reason.value, reason.bound) == (
        ReasonCode.LINK_TOO_SLOW,
        "cycles",
        51,
        50,
    )
    assert bench.answer(bench.cycle - 50, seq=2) == []


def test_the_sight_of_a_controller_is_published_with_each_state_during_the_lease() -> None:
    bench = Bench(playout=False)
    _, state, _ = bench.turn()
    assert (state.sight, state.target) == (None, None)
    for seq, sight in enumerate([Sight.FRESH, Sight.HIDDEN, Sight.STALE, Sight.LOST], start=1):
        target = ViewTarget(focus_m=(0.0, 0.0, float(seq)))
        seen = {"sight": sight, "target": target}
        asked = Increment(robot="fr", seq=seq, cycle=bench.cycle, dq=DQ, lease=bench.lease, **seen)
        bench.core.increments.on_increment(asked, bench.client, bench.time_s)
        other = Bench(playout=False)
        other.core.restore(bench.core.snapshot())
        assert remembered(other.core) == remembered(bench.core)
        _, state, _ = bench.turn()
        assert (state.sight, state.target) == (sight, target)
    foreign = Increment(robot="fr", seq=9, cycle=bench.cycle, dq=DQ, lease="another", sight=Sight.FRESH)
    bench.core.increments.on_increment(foreign, bench.client, bench.time_s)
    assert bench.turn()[1].sight is Sight.LOST, "only the holder says what is seen"
    release = LeaseRequest(robot="fr", action=LeaseAction.RELEASE, lease=bench.lease)
    bench.core.requests.on_lease(release, bench.client, bench.time_s)
    state = bench.turn()[1]
    assert (state.sight, state.target) == (None, None)


def test_without_a_buffer_nothing_changes() -> None:
    bench = Bench(playout=False)
    for _ in range(30):
        _, state, _ = bench.turn()
    assert state.playout is None
    (refused,) = verdicts(bench.answer(bench.cycle - 25, seq=1))
    assert refused.reasons[0].code is ReasonCode.STALE_CYCLE


@pytest.mark.parametrize("ends", ["stop", "release", "held"])
def test_waiting_increments_are_refused_when_the_robot_is_stopped_held_or_released(ends: str) -> None:
    bench = Bench()
    for _ in range(20):
        bench.turn()
    bench.answer(bench.cycle - 9, seq=1)
    bench.turn()  # a delay of ten cycles
    for seq in range(2, 7):
        bench.answer(bench.cycle, seq)
        bench.turn()
    outputs: list[Output] = []
    if ends == "stop":
        outputs = bench.core.requests.on_stop(StopRequest(), bench.client, bench.time_s)
    elif ends == "release":
        release = LeaseRequest(robot="fr", action=LeaseAction.RELEASE, lease=bench.lease)
        outputs = bench.core.requests.on_lease(release, bench.client, bench.time_s)
    refused = verdicts(outputs)
    for _ in range(20):
        held = {"phase": Phase.HELD} if ends == "held" else {}
        request, state, more = bench.turn(**held)
        assert request.dq is None
        refused += more
    assert [one.seq for one in refused] == [2, 3, 4, 5, 6]
    assert {one.outcome for one in refused} == {Outcome.REFUSED}
    code = ReasonCode.LEASE_NOT_HELD if ends == "release" else ReasonCode.STOPPED
    assert {one.reasons[0].code for one in refused} == {code}
    assert (state.playout is None) == (ends == "release")


def test_an_hli_restored_from_a_snapshot_behaves_identically(bench: Bench) -> None:
    for seq in range(1, 20):
        bench.turn()
        bench.answer(max(100, bench.cycle - 5), seq)
    memory, other = bench.core.snapshot(), Bench()
    other.core.restore(memory)
    other.cycle, other.time_s, other.client = bench.cycle, bench.time_s, bench.client
    for _ in range(10):
        assert other.turn() == bench.turn()
