"""Questions over zenoh: whoever asks too much waits, whatever they prove, and no question is lost by that."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from deltaq_protocol import topics
from deltaq_services.hli import zenoh_session
from deltaq_services.hli.zenoh_session import HliSession


class Waits:
    """In place of what makes a session's thread wait: notes after how many questions it was asked to."""

    def __init__(self, _most_s: float) -> None:
        self.asked = 0

    def one_more(self) -> None:
        self.asked += 1


class Session:
    """In place of a zenoh session: what was declared is called by the test."""

    def declare_queryable(self, key: str, callback: Any) -> Any:
        self.put = callback.callback
        return self

    def undeclare(self) -> None: ...

    def close(self) -> None: ...


@pytest.mark.parametrize(
    ("topic", "goes_first"), [(topics.RESET, lambda _: True), (topics.STOP, None), (topics.STATUS, None)]
)
async def test_proven_clients_and_stops_are_served_and_then_their_session_is_rate_limited(
    monkeypatch: pytest.MonkeyPatch, topic: topics.Topic, goes_first: Callable[[Any], bool] | None
) -> None:
    waits: list[Waits] = []
    monkeypatch.setattr(zenoh_session, "FloodWait", lambda most_s: waits.append(Waits(most_s)) or waits[-1])
    taken: list[int] = []
    session = Session()
    hli_session = HliSession(session, "small", asyncio.get_running_loop())
    hli_session.answer(topic, taken.append, goes_first)
    for query in range(100):
        session.put(query)
        assert sum(wait.asked for wait in waits) == query + 1
    while len(taken) < 100:
        before = len(taken)
        await asyncio.sleep(0)
        assert len(taken) - before <= zenoh_session._QUERIES_A_TURN, "the loop turns to others in between"
    assert taken == list(range(100))
    hli_session.close()


async def test_floods_of_proven_and_unproven_queries_do_not_delay_one_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    waits: list[Waits] = []
    monkeypatch.setattr(zenoh_session, "FloodWait", lambda most_s: waits.append(Waits(most_s)) or waits[-1])
    session = Session()
    hli_session = HliSession(session, "small", asyncio.get_running_loop())
    hli_session.answer(topics.RESET, lambda _: None, lambda query: bool(query % 2))
    for query in range(9):
        session.put(query)
    assert sorted(wait.asked for wait in waits) == [4, 5]
    hli_session.close()
