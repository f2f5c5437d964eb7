import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_emulator.settings import FIELD_OF_VIEW, LateBudget


def through(link: FaultyLink, count: int, spacing_s: float = 0.012) -> list[bytes]:
    """What arrives when datagrams `0`, `1`, … are sent at that spacing."""
    out = []
    for k in range(count):
        link.put(k * spacing_s, b"%d" % k)
        out += link.take(k * spacing_s)
    return out + link.take(1e9)


def test_without_faults_everything_passes_at_once_and_in_order() -> None:
    link = FaultyLink()
    for k in range(50):
        link.put(1.0, b"%d" % k)
    assert link.next_s == 1.0
    assert link.take(1.0) == [b"%d" % k for k in range(50)]
    assert link.next_s is None
    assert link.counts["passed"] == 50


def test_dropped_datagrams_never_arrive() -> None:
    link = FaultyLink(seed=3)
    link.faults = LinkFaults(drop=0.25)
    arrived = through(link, 1000)
    assert 700 < len(arrived) < 800
    assert link.counts["dropped"] == 1000 - len(arrived)
    assert arrived == sorted(arrived, key=int)


def test_a_delay_postpones_each_datagram_by_its_length() -> None:
    link = FaultyLink()
    link.faults = LinkFaults(delay_s=0.005)
    link.put(1.0, b"a")
    assert link.take(1.004) == []
    assert link.next_s == pytest.approx(1.005)
    assert link.take(1.0051) == [b"a"]


def test_jitter_stays_within_its_bound() -> None:
    link = FaultyLink(seed=1)
    link.faults = LinkFaults(delay_s=0.001, jitter_s=0.004)
    dues = []
    for _ in range(300):
        link.put(0.0, b"a")
        assert link.next_s is not None
        dues.append(link.next_s)
        link.take(1.0)
    assert 0.001 <= min(dues) < 0.0015
    assert 0.0045 < max(dues) <= 0.005


def test_queued_jitter_keeps_the_order_and_other_jitter_does_not() -> None:
    for keeps_order in (True, False):
        link, arrived = FaultyLink(seed=2), []
        link.faults = LinkFaults(jitter_s=0.02, keeps_order=keeps_order)
        for number in range(200):
            now_s = 0.002 * number
            link.put(now_s, b"%d" % number)
            arrived += link.take(now_s)
        arrived = [int(datagram) for datagram in arrived + link.take(1.0)]
        assert len(arrived) == 200
        assert (arrived == sorted(arrived)) is keeps_order


def test_duplicates_arrive_twice() -> None:
    link = FaultyLink()
    link.faults = LinkFaults(duplicate=1.0)
    assert through(link, 3) == [b"0", b"0", b"1", b"1", b"2", b"2"]


def test_a_reordered_datagram_arrives_after_the_next_ordered_one() -> None:
    link = FaultyLink(seed=5)
    link.faults = LinkFaults(reorder=0.3)
    arrived = [int(datagram) for datagram in through(link, 200)]
    assert arrived != sorted(arrived)
    assert link.counts["reordered"] > 30
    link.faults = LinkFaults()
    link.put(1e9, b"last")
    assert len(arrived) + len(link.take(2e9)) == 201


def test_corrupted_datagrams_arrive_changed() -> None:
    link = FaultyLink(seed=2)
    link.faults = LinkFaults(corrupt=1.0)
    link.put(0.0, b"<Sen/>")
    link.put(0.0, b"")
    first, second = link.take(0.0)
    assert first != b"<Sen/>"
    assert second != b""
    assert link.counts["corrupted"] == 2


def test_a_flipped_digit_gives_a_valid_telegram_that_differs_in_one_digit() -> None:
    link = FaultyLink(seed=4)
    link.faults = LinkFaults(flip=1.0)
    sent = b'<AIPos A1="12.3456"/>'
    for _ in range(200):
        link.put(0.0, sent)
        (arrived,) = link.take(0.0)
        (place,) = (number for number, (old, new) in enumerate(zip(sent, arrived, strict=True)) if old != new)
        assert sent[place : place + 1].isdigit()
        assert arrived[place : place + 1].isdigit()
    link.put(0.0, b"<none/>")
    assert link.take(0.0) == [b"<none/>"]
    assert link.counts["flipped"] == 201


def test_a_truncated_datagram_is_the_beginning_of_what_was_sent() -> None:
    link = FaultyLink(seed=4)
    link.faults = LinkFaults(truncate=1.0)
    for sent in [b"<Sen/>"] * 50 + [b""]:
        link.put(0.0, sent)
        (arrived,) = link.take(0.0)
        assert sent.startswith(arrived)
        assert len(arrived) < max(len(sent), 1)
    assert link.counts["truncated"] == 51


def test_unused_faults_draw_no_random_numbers() -> None:
    runs = []
    for extra in ({}, {"flip": 0.0, "truncate": 0.0}):
        link = FaultyLink(seed=9)
        link.faults = LinkFaults(drop=0.2, corrupt=0.2, **extra)
        runs.append(through(link, 100))
    assert runs[0] == runs[1]


@given(st.integers(0, 2**32), st.floats(0, 1), st.floats(0, 1), st.floats(0, 1), st.floats(0, 1))
def test_one_seed_is_one_run(
    seed: int, drop: float, duplicate: float, reorder: float, corrupt: float
) -> None:
    runs = []
    for _ in range(2):
        link = FaultyLink(seed)
        link.faults = LinkFaults(
            drop=drop, duplicate=duplicate, reorder=reorder, corrupt=corrupt, jitter_s=0.02
        )
        runs.append(through(link, 30))
    assert runs[0] == runs[1]


def exceeded_after(budget: LateBudget, cycles: list[bool]) -> int | None:
    """The cycle in which the budget was exceeded first."""
    for number, late in enumerate(cycles, start=1):
        budget.cycle(late)
        if budget.exceeded is not None:
            return number
    return None


@pytest.mark.parametrize(
    ("rule", "exceeded"), [("consecutive", None), ("total", 7), ("share", None)], ids=lambda value: str(value)
)
def test_interrupted_late_cycles_exceed_only_the_budget_of_all_cycles(
    rule: str, exceeded: int | None
) -> None:
    assert exceeded_after(LateBudget(rule, 3, 50.0), [True, False] * 100) == exceeded


def test_a_share_is_exceeded_by_one_more_than_that_share_of_a_thousand() -> None:
    assert exceeded_after(LateBudget("share", 0, 2.5), [True] * 100) == 26


def test_late_cycles_leave_the_window_after_a_thousand() -> None:
    budget = LateBudget("share", 0, 2.5)
    ten_of_a_thousand = [True] * 10 + [False] * (FIELD_OF_VIEW - 10)
    assert exceeded_after(budget, ten_of_a_thousand * 5) is None
    assert budget.counted == 10
    assert exceeded_after(budget, [True] * 10 + [False] * 500 + [True] * 100) == 10 + 500 + 16


def test_a_new_session_counts_from_zero() -> None:
    for rule in ("consecutive", "total", "share"):
        budget = LateBudget(rule, 3, 0.3)
        assert exceeded_after(budget, [True] * 4) == 4
        budget.begin_session()
        assert (budget.exceeded, budget.counted) == (None, 0)
        assert exceeded_after(budget, [True] * 4) == 4


def test_a_budget_of_zero_permits_no_late_cycle() -> None:
    for rule in ("consecutive", "total", "share"):
        assert exceeded_after(LateBudget(rule, 0, 0.0), [False] * 5 + [True]) == 6


@given(st.lists(st.booleans(), max_size=2500))
def test_the_share_agrees_with_a_window_over_the_whole_history(cycles: list[bool]) -> None:
    budget = LateBudget("share", 0, 100.0)
    for late in cycles:
        budget.cycle(late)
    assert budget.counted == sum(cycles[-FIELD_OF_VIEW:])
