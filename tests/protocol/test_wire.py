"""Questions over real zenoh: to somebody who comes late, who does not answer, or who never comes."""

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh
from small_cell import endpoint

from deltaq_protocol import topics
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.messages import DescribeRequest, Done
from deltaq_protocol.session import open_session
from deltaq_protocol.wire import Wire

CELL = "cell"
KEY = topics.STATUS.key(CELL)
LONG_S = 60.0
"""Longer than anything here takes, however busy the machine is."""


@pytest.fixture
def ends() -> Iterator[tuple[Any, Any]]:
    """Sessions of a server and of a client, linked."""
    somewhere = endpoint()
    server = open_session(listen=[somewhere])
    client = open_session(connect=[somewhere], must_connect=True)
    yield server, client
    client.close()
    server.close()


async def test_a_query_waits_for_a_server(ends: tuple[Any, Any]) -> None:
    server, client = ends

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(KEY, pack(Done(what="status")))

    wire = Wire(client, asyncio.get_running_loop())
    asked = asyncio.create_task(wire.ask(topics.STATUS, CELL, DescribeRequest(), deadline_s=LONG_S))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert not asked.done()
    server.declare_queryable(KEY, answer)
    assert unpack(Done, await asked).what == "status"


async def test_an_accepted_query_is_not_repeated_without_an_answer(
    ends: tuple[Any, Any],
) -> None:
    server, client = ends
    taken: list[str] = []

    def take(query: zenoh.Query) -> None:
        with query:
            taken.append(str(query.key_expr))

    server.declare_queryable(KEY, take)
    wire = Wire(client, asyncio.get_running_loop())
    with pytest.raises(ServiceUnreachableError, match="is the cell up"):
        await wire.ask(topics.STATUS, CELL, DescribeRequest(), deadline_s=LONG_S)
    assert taken == [KEY]


async def test_a_query_without_a_server_ends_at_its_deadline(ends: tuple[Any, Any]) -> None:
    _, client = ends
    with pytest.raises(ServiceUnreachableError, match=f"no answer to {KEY} within 0.05 s"):
        await Wire(client, asyncio.get_running_loop()).ask(
            topics.STATUS, CELL, DescribeRequest(), deadline_s=0.05
        )
