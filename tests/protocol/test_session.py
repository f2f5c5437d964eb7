"""zenoh sessions: found only by address, found again when lost, and errors that say what to do."""

import contextlib
import resource
import socket
import sys
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from ran import ran
from small_cell import endpoint

from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.inbox import called_in_zenohs_threads
from deltaq_protocol.session import MAX_SESSIONS, declare_publisher, open_session, subscribe_newest
from deltaq_protocol.topic import Priority
from deltaq_protocol.wire import in_order


class Heard:
    """Payloads of a key, as they come."""

    def __init__(self, session: Any, key: str) -> None:
        self.payloads: list[bytes] = []
        self._changed = threading.Condition()
        self._subscriber = session.declare_subscriber(key, self._take)

    def _take(self, sample: Any) -> None:
        with self._changed:
            self.payloads.append(sample.payload.to_bytes())
            self._changed.notify_all()

    def until(self, publish: Any) -> None:
        """Publish until something is heard."""
        give_up = time.monotonic() + 300
        with self._changed:
            while not self.payloads:
                assert time.monotonic() < give_up, "nothing heard"
                publish()
                self._changed.wait(0.02)

    def wait_for(self, payload: bytes) -> None:
        """Wait until this is what came last."""
        with self._changed:
            came = self._changed.wait_for(lambda: self.payloads[-1:] == [payload], timeout=300)
            assert came, self.payloads[-1:]


def test_an_endpoint_without_a_listener_fails_with_a_remedy() -> None:
    nowhere = endpoint()
    with pytest.raises(ServiceUnreachableError, match=f"{nowhere}.*is the cell up"):
        open_session(connect=[nowhere], must_connect=True)


def test_listening_on_a_used_address_fails_with_the_reason_of_the_system() -> None:
    taken = endpoint()
    first = open_session(listen=[taken])
    with pytest.raises(ServiceUnreachableError, match=f"cannot listen on {taken}.*in use") as told:
        open_session(listen=[taken])
    assert ".rs" not in str(told.value)
    first.close()


def test_sessions_without_a_common_endpoint_never_connect(opened) -> None:
    there = endpoint()
    one, other = opened(listen=[endpoint()]), opened(listen=[there])
    heard = Heard(other, "deltaq/**")
    for _ in range(20):
        one.put("deltaq/lab/stop", b"x")
    # by the time that a session which knows the address has been heard, whoever could be heard has been
    known = open_session(connect=[there], must_connect=True)
    Heard(other, "marker").until(lambda: known.put("marker", b"x"))
    known.close()
    assert heard.payloads == []
    assert list(one.info.peers_zid()) == []


def transports(session: Any) -> set[str]:
    """Kinds of links that a session has."""
    return {str(link.dst).partition("/")[0] for link in session.info.links()}


def wait_for_datagrams(session: Any) -> None:
    """Until a session has its second link."""
    for event in session.info.declare_link_events_listener(history=True):
        if str(event.link.dst).startswith("udp/"):
            return


@pytest.mark.parametrize(
    ("listens", "connects", "has"),
    [
        ("tcp+udp", "tcp+udp", {"tcp", "udp"}),
        ("tcp+udp", "tcp", {"tcp"}),
        ("tcp", "tcp+udp", {"tcp"}),
    ],
)
def test_datagrams_are_used_if_both_ends_offer_them_and_messages_arrive_either_way(
    opened, listens: str, connects: str, has: set[str]
) -> None:
    at = endpoint().partition("/")[2]
    server = opened(listen=[f"{listens}/{at}"])
    client = opened(connect=[f"{connects}/{at}"], must_connect=True)
    if "udp" in has:
        wait_for_datagrams(client)
    heard = Heard(client, "deltaq/x")
    publisher = declare_publisher(server, "deltaq/x")
    heard.until(lambda: publisher.put(b"x"))
    assert transports(client) <= has  # a busy machine may have lost one of two meanwhile


@contextlib.contextmanager
def datagrams_between(near: tuple[str, int], far: tuple[str, int]) -> Iterator[list[bytes]]:
    """Carry datagrams from whoever sends to `near` on to `far`, and its own back; those that it sent are listed."""
    sent_back: list[bytes] = []
    with socket.socket(type=socket.SOCK_DGRAM) as here, socket.socket(type=socket.SOCK_DGRAM) as there:
        here.bind(near)
        there.connect(far)
        sender: list[Any] = []

        def onward() -> None:
            while datagram := here.recvfrom(65536):
                if datagram[1] == near:
                    return
                sender[:] = [datagram[1]]
                there.send(datagram[0])

        def back() -> None:
            while datagram := there.recv(65536):
                sent_back.append(datagram)
                here.sendto(datagram, sender[0])

        threads = [threading.Thread(target=way) for way in (onward, back)]
        for thread in threads:
            thread.start()
        yield sent_back
        here.sendto(b"the end", near)
        threads[0].join()
        there.shutdown(socket.SHUT_RD)
        threads[1].join()


def test_only_urgent_streams_use_datagrams(opened) -> None:
    one, other = (endpoint().partition("/")[2] for _ in range(2))
    host, _, port = one.rpartition(":")
    server = opened(listen=[f"tcp/{one}", f"tcp+udp/{other}"])
    with datagrams_between((host, int(port)), (host, int(other.rpartition(":")[2]))) as seen:
        client = opened(connect=[f"tcp+udp/{one}"], must_connect=True)
        at_x, at_y = Heard(client, "deltaq/x"), Heard(client, "deltaq/y")
        wait_for_datagrams(server)
        urgent = declare_publisher(server, "deltaq/x")
        ordinary = declare_publisher(server, "deltaq/y", priority=Priority.ORDINARY)
        at_y.until(lambda: ordinary.put(b"ordinary"))
        while not any(b"urgent" in datagram for datagram in seen):  # until the new link is used
            at_x.payloads.clear()
            at_x.until(lambda: urgent.put(b"urgent"))
        assert not any(b"ordinary" in datagram for datagram in seen)


def test_a_client_connects_through_a_firewall_that_drops_datagrams(opened) -> None:
    at = endpoint().partition("/")[2]
    host, _, port = at.rpartition(":")
    server = opened(listen=[f"tcp/{at}"])
    with socket.socket(type=socket.SOCK_DGRAM) as wall:
        wall.bind((host, int(port)))
        client = opened(connect=[f"tcp+udp/{at}"], must_connect=True)
        heard = Heard(client, "deltaq/x")
        heard.until(lambda: server.put("deltaq/x", b"x"))
        assert transports(client) == {"tcp"}


def test_an_overtaken_sample_is_ignored_and_a_new_publisher_counts_from_the_start() -> None:
    def sample(second: int, publisher: bytes) -> Any:
        return SimpleNamespace(
            timestamp=zenoh.Timestamp(datetime(2026, 1, 1, 0, 0, second, tzinfo=UTC), publisher)
        )

    one, late, next_one, other = sample(1, b"a"), sample(0, b"a"), sample(2, b"a"), sample(0, b"b")
    plain = SimpleNamespace(timestamp=None)
    taken: list[Any] = []
    put = in_order(taken.append)
    for each in (plain, one, late, next_one, other, plain):
        put(each)
    assert taken == [plain, one, next_one, other, plain]


def test_a_server_relays_no_messages_between_clients(opened) -> None:
    here = endpoint()
    server = opened(listen=[here])
    one, other = (opened(connect=[here], must_connect=True) for _ in range(2))
    at_server, at_other = Heard(server, "deltaq/**"), Heard(other, "deltaq/**")
    at_server.until(lambda: one.put("deltaq/lab/fr/verdict", b"forged"))
    marker = Heard(other, "marker")
    marker.until(lambda: server.put("marker", b"x"))
    assert at_other.payloads == []


def test_a_later_or_restarted_server_is_found_automatically(opened) -> None:
    here = endpoint()
    client = opened(connect=[here])
    publisher = declare_publisher(client, "deltaq/x")
    for _ in range(2):
        server = opened(listen=[here])
        Heard(server, "deltaq/x").until(lambda: publisher.put(b"x"))
        server.close()


def test_a_slow_reader_gets_the_newest_missed_sample(opened) -> None:
    here = endpoint()
    server = opened(listen=[here])
    client = opened(connect=[here], must_connect=True)
    newest = subscribe_newest(client, "deltaq/x")
    after = Heard(client, "deltaq/x")
    after.until(lambda: server.put("deltaq/x", b"first"))
    for k in range(100):
        server.put("deltaq/x", str(k).encode())
    after.wait_for(b"99")
    assert newest.try_recv().payload.to_bytes() == b"99"
    assert newest.try_recv() is None


@pytest.mark.long
def test_a_session_beyond_the_limit_waits_until_another_leaves(opened) -> None:
    here = endpoint()
    opened(listen=[here])
    others = [opened(connect=[here], must_connect=True) for _ in range(MAX_SESSIONS)]
    with pytest.raises(ServiceUnreachableError, match=f"fewer than {MAX_SESSIONS} others there"):
        opened(connect=[here], must_connect=True)
    others.pop().close()
    others.append(opened(connect=[here], must_connect=True))


def test_silent_connections_delay_a_session_without_excluding_it(opened) -> None:
    here = endpoint()
    server = opened(listen=[here])
    client = opened(connect=[here], must_connect=True)
    address = ("127.0.0.1", int(here.rpartition(":")[2]))
    with contextlib.ExitStack() as silent:
        for _ in range(300):
            silent.enter_context(socket.create_connection(address))
        Heard(client, "deltaq/x").until(lambda: server.put("deltaq/x", b"x"))
        patient = open_session(connect=[here])  # tries until it is let in
        Heard(patient, "deltaq/x").until(lambda: server.put("deltaq/x", b"x"))
        patient.close()


def test_a_blocked_subscriber_delays_no_other_and_fills_no_memory() -> None:
    here = endpoint()
    server = open_session(listen=[here])
    stuck, quick = (open_session(connect=[here], must_connect=True) for _ in range(2))
    released, is_stuck = threading.Event(), threading.Event()

    def read_no_more(_: Any) -> None:
        is_stuck.set()
        released.wait()

    try:
        # in the thread that reads the socket: nobody empties it from now on
        callback = zenoh.handlers.Callback(read_no_more, indirect=False)
        subscriber = stuck.declare_subscriber("deltaq/x", callback)
        heard = Heard(quick, "deltaq/x")
        publisher = declare_publisher(server, "deltaq/x")
        while not is_stuck.is_set():
            publisher.put(b"begin")
        before = resident_bytes()
        payload = b"x" * 60_000
        for k in range(3000):
            publisher.put(payload)
            if k % 100 == 0:
                heard.until(lambda: publisher.put(b"again"))
                heard.payloads.clear()  # so that only what waits for the other could fill the memory
        heard.until(lambda: publisher.put(b"end"))
        assert resident_bytes() - before < 90e6  # half of what was sent, and zenoh's own queues are below it
        released.set()
        subscriber.undeclare()
    finally:
        released.set()
        for session in (stuck, quick, server):
            session.close()


def resident_bytes() -> int:
    """Memory of this process."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * resource.getpagesize()


@pytest.mark.long
def test_importing_the_protocol_loads_neither_pinocchio_nor_coal_nor_the_cell() -> None:
    script = (
        "import sys, deltaq_protocol, deltaq_protocol.blocking\n"
        "heavy = {'pinocchio', 'coal', 'deltaq_cell', 'deltaq_services'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)\n"
    )
    ran([sys.executable, "-c", script])


def test_a_thread_of_zenohs_keeps_its_python_state_from_one_message_to_the_next() -> None:
    here = endpoint()
    server = open_session(listen=[here])
    client = open_session(connect=[here], must_connect=True)
    kept = threading.local()
    calls: dict[int, list[int]] = {}
    enough = threading.Event()

    def count(_: Any) -> None:
        kept.calls = getattr(kept, "calls", 0) + 1
        calls.setdefault(threading.get_ident(), []).append(kept.calls)
        if sum(map(len, calls.values())) == 20:
            enough.set()

    try:
        subscriber = client.declare_subscriber("deltaq/x", called_in_zenohs_threads(count))
        publisher = declare_publisher(server, "deltaq/x")
        while not enough.is_set():
            publisher.put(b"x")
        for numbers in calls.values():
            assert numbers == list(range(1, len(numbers) + 1))
        subscriber.undeclare()
    finally:
        client.close()
        server.close()
