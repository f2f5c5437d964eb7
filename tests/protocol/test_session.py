"""zenoh sessions: found only by address, found again when lost, and errors that say what to do."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from small_cell import endpoint

from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.session import declare_publisher, open_session, subscribe_newest


class Heard:
    """Payloads of a key, as they come."""

    def __init__(self, session: Any, key: str) -> None:
        self.payloads: list[bytes] = []
        self._came = threading.Event()
        self._subscriber = session.declare_subscriber(key, self._take)

    def _take(self, sample: Any) -> None:
        self.payloads.append(sample.payload.to_bytes())
        self._came.set()

    def until(self, publish: Any) -> None:
        """Publish until something is heard."""
        give_up = time.monotonic() + 10
        while not self._came.is_set():
            assert time.monotonic() < give_up, "nothing heard"
            publish()
            self._came.wait(0.02)


def test_an_endpoint_where_nobody_listens_fails_when_it_must_be_reached_and_says_what_to_do() -> None:
    nowhere = endpoint()
    with pytest.raises(ServiceUnreachableError, match=f"{nowhere}.*is the cell up"):
        open_session(connect=[nowhere], must_connect=True)


def test_a_session_that_keeps_trying_opens_at_once_though_nobody_is_there_yet() -> None:
    started = time.monotonic()
    open_session(connect=[endpoint()]).close()
    assert time.monotonic() - started < 0.4


def test_an_endpoint_that_is_taken_cannot_be_listened_on() -> None:
    here = endpoint()
    first = open_session(listen=[here])
    try:
        with pytest.raises(ServiceUnreachableError, match=here):
            open_session(listen=[here])
    finally:
        first.close()


def test_sessions_that_do_not_name_one_another_never_meet() -> None:
    one, other = open_session(listen=[endpoint()]), open_session(listen=[endpoint()])
    try:
        heard = Heard(other, "deltaq/**")
        for _ in range(20):
            one.put("deltaq/lab/stop", b"x")
            time.sleep(0.01)
        assert heard.payloads == []
        assert list(one.info.peers_zid()) == []
    finally:
        one.close()
        other.close()


def test_a_server_does_not_pass_on_what_one_client_sends_to_another() -> None:
    here = endpoint()
    server = open_session(listen=[here])
    one, other = (open_session(connect=[here], must_connect=True) for _ in range(2))
    try:
        at_server, at_other = Heard(server, "deltaq/**"), Heard(other, "deltaq/**")
        at_server.until(lambda: one.put("deltaq/lab/fr/verdict", b"forged"))
        marker = Heard(other, "marker")
        marker.until(lambda: server.put("marker", b"x"))
        assert at_other.payloads == []
    finally:
        for session in (one, other, server):
            session.close()


def test_a_server_that_comes_later_or_again_is_found_without_being_asked() -> None:
    here = endpoint()
    client = open_session(connect=[here])
    publisher = declare_publisher(client, "deltaq/x")
    try:
        for _ in range(2):
            server = open_session(listen=[here])
            Heard(server, "deltaq/x").until(lambda: publisher.put(b"x"))
            server.close()
    finally:
        client.close()


def test_of_what_a_slow_reader_missed_only_the_newest_is_kept() -> None:
    here = endpoint()
    server = open_session(listen=[here])
    client = open_session(connect=[here], must_connect=True)
    try:
        newest = subscribe_newest(client, "deltaq/x")
        after = Heard(client, "deltaq/x")
        after.until(lambda: server.put("deltaq/x", b"first"))
        for k in range(100):
            server.put("deltaq/x", str(k).encode())
        give_up = time.monotonic() + 10
        while after.payloads[-1] != b"99":
            assert time.monotonic() < give_up
            time.sleep(0.005)
        assert newest.try_recv().payload.to_bytes() == b"99"
        assert newest.try_recv() is None
    finally:
        client.close()
        server.close()


def test_importing_the_protocol_loads_neither_pinocchio_nor_coal_nor_the_cell() -> None:
    script = (
        "import sys, deltaq_protocol, deltaq_protocol.blocking\n"
        "heavy = {'pinocchio', 'coal', 'deltaq_cell', 'deltaq_services'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
