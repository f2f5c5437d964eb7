"""Whose line is served next, in virtual time."""

from collections import Counter

from deltaq_services.hli.places import (
    MAX_CONNECTIONS,
    MAX_OF_A_PEER,
    MAX_STOP_PLACES,
    LineTurns,
    Places,
)


def flooded(turns: LineTurns[str], floods: list[str], holder: str | None, seconds: float) -> Counter[str]:
    """Lines served of each, when all but the holder always have one waiting and the holder has one every 4 ms."""
    served: Counter[str] = Counter()
    for tick in range(round(seconds * 10_000)):
        now_s = tick * 1e-4
        for name in floods:
            turns.wait(name, is_holder=False)
        if holder is not None and tick % 40 == 0:
            turns.wait(holder, is_holder=True)
        who = turns.next(now_s)
        if who is not None:
            served[who] += 1
            if tick % 40 == 0 and holder is not None:
                assert who == holder  # at once, whoever else waits
    return served


def test_a_lease_holder_is_served_at_once_during_a_flood() -> None:
    floods = [f"flood-{k}" for k in range(63)]
    served = flooded(LineTurns(), floods, "holder", 2.0)
    assert served["holder"] == 500
    together = sum(served[name] for name in floods)
    assert together <= 2 * 2000 + 2000
    assert max(served[name] for name in floods) - min(served[name] for name in floods) <= 1


def test_a_connection_has_a_rate_and_its_lines_wait() -> None:
    served = flooded(LineTurns(most_lines_s=100.0), ["flood"], None, 3.0)
    assert 3 * 100 <= served["flood"] <= 4 * 100 + 1
    holders = LineTurns[str](most_lines_s=100.0)
    for k in range(1000):
        holders.wait("holder", is_holder=True)
        assert (holders.next(0.0) is not None) == (k < 100)
    assert holders  # what is beyond is not lost


def test_a_closed_connection_is_not_served() -> None:
    turns = LineTurns[str]()
    turns.wait("gone", is_holder=True)
    turns.leave("gone")
    assert turns.next(0.0) is None
    assert not turns


def test_a_new_lease_holder_is_served_with_priority_and_once() -> None:
    turns = LineTurns[str]()
    turns.wait("other", is_holder=False)
    turns.wait("me", is_holder=False)
    turns.wait("me", is_holder=True)
    assert [turns.next(0.0) for _ in range(3)] == ["me", "other", None]


def test_a_connection_beyond_the_limit_may_stop_and_silent_ones_exclude_none() -> None:
    places = Places[int]()
    given = [places.take(k, "127.0.0.1") for k in range(MAX_CONNECTIONS + 1000)]
    assert given == [True] * MAX_CONNECTIONS + [False] * 1000
    kept = range(MAX_CONNECTIONS, MAX_CONNECTIONS + 1000)
    gave_way = [old for old in map(places.keep_for_stop, kept) if old is not None]
    assert gave_way == list(range(MAX_CONNECTIONS, MAX_CONNECTIONS + 1000 - MAX_STOP_PLACES))
    assert places.leave(0)
    assert not places.leave(MAX_CONNECTIONS + 999)
    assert places.take(-1, "127.0.0.1")


def test_one_remote_address_cannot_take_all_places() -> None:
    places = Places[int]()
    given = [places.take(k, "192.0.2.1") for k in range(MAX_CONNECTIONS)]
    assert given.count(True) == MAX_OF_A_PEER
    assert places.take(-1, "192.0.2.2")
