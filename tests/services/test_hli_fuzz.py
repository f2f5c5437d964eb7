"""Whatever a client sends, over TCP or zenoh, the HLI answers, goes on, and lets nothing through to the gate."""

import json
import socket
from collections.abc import Iterator
from typing import Any, BinaryIO

import msgpack
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from served import Server

from deltaq_protocol import topics
from deltaq_protocol.blocking import connect
from deltaq_protocol.proof import Prover
from deltaq_protocol.session import open_session

pytestmark = pytest.mark.long

# everything of a module shares one server: it must survive all of it
lasting = settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([10**400, 2**63, -1])
    | st.floats()
    | st.text()
    | st.sampled_from(["fr", "gr", "gripper", "acquire", "take", "\ud800", "*", "a" * 70]),
    lambda inner: (
        st.lists(inner, max_size=8) | st.dictionaries(st.text() | st.just("gripper"), inner, max_size=3)
    ),
    max_leaves=10,
)
FIELDS = st.sampled_from(
    ["robot", "seq", "cycle", "dq", "lease", "action", "client", "token", "outputs", "protocol", "\ud800"]
)
TYPES = st.sampled_from(["hello", "lease", "increment", "io", "reset", "describe", "unheard-of"]) | VALUES
VALID: dict[str, dict[str, Any]] = {
    "hello": {"protocol": 1, "client": "fuzz"},
    "lease": {"robot": "fr", "action": "renew"},
    "increment": {"robot": "fr", "seq": 1, "cycle": 1, "dq": [0.0] * 6},
    "io": {"robot": "gr", "outputs": {}},
    "reset": {"robot": "ghost"},
}
OBJECTS = st.builds(
    lambda kind, changes: (VALID.get(kind, {}) if isinstance(kind, str) else {}) | {"type": kind} | changes,
    TYPES,
    st.dictionaries(FIELDS, VALUES, max_size=3),
).filter(lambda data: data["type"] != "stop")  # it is answered when the gate has stopped, which is not there
LINES = OBJECTS.map(lambda data: json.dumps(data).encode()) | st.binary(max_size=100).map(
    lambda line: line.replace(b"\n", b"")
)
HELLO = b'{"type":"hello","protocol":1,"client":"fuzz"}\n'


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """A server whose robots are leased for good: nothing that a stranger sends may reach the gate."""
    with Server(operator_token="s3cret", lease_s=600.0) as running:
        with connect(running.description.hli, client="holder") as cell, cell.lease("fr"), cell.lease("gr"):
            yield running
        assert running.hli.core.counters["requests"] == 0
        assert running.errors == []


@pytest.fixture(scope="module")
def session(server: Server) -> Iterator[Any]:
    opened = open_session(connect=[server.description.hli], must_connect=True)
    yield opened
    opened.close()


def packed(data: Any) -> bytes:
    try:
        payload: bytes = msgpack.packb(data)
    except (OverflowError, UnicodeEncodeError, ValueError):
        payload = b"\x80"
    return payload


def dialogue(server: Server, lines: list[bytes]) -> list[dict[str, Any]]:
    """Send lines after a hello and before a describe; everything that was answered, without the states.

    A stop is answered when robots have shown that they obey, and others meanwhile.
    """
    with socket.create_connection(("127.0.0.1", server.description.tcp_port), timeout=300) as sock:
        stream: BinaryIO = sock.makefile("rb")
        sock.sendall(HELLO + b"".join(line + b"\n" for line in lines))
        sock.sendall(b'{"type":"describe"}\n')
        answers, is_described = [], False
        with stream:
            for answer in stream:
                data = json.loads(answer)
                if data["type"] != "state":
                    answers.append(data)
                is_described |= data["type"] == "description"
                all_came = is_described and len(answers) >= len(lines) + 2
                if all_came or data.get("code") == "protocol_version":
                    break
    return answers


@lasting
@given(st.lists(LINES, max_size=5))
@example([b'{"type":"stop"}', b'{"type":"describe"}'])
def test_every_line_is_answered_and_connection_and_service_survive(
    server: Server, lines: list[bytes]
) -> None:
    answers = dialogue(server, lines)
    if answers[-1].get("code") != "protocol_version":
        assert len(answers) == len(lines) + 2, (lines, answers)
    assert server.errors == []
    assert server.peer.increments.empty()


@lasting
@given(payload=st.binary(max_size=200) | OBJECTS.map(packed))
def test_no_payload_on_any_key_of_the_open_realm_harms_the_service(
    server: Server, session: Any, payload: bytes
) -> None:
    for robot in ("fr", "ghost"):
        session.put(topics.INCREMENT.key("small", robot=robot), payload)
        session.put(topics.INCREMENT.key("small", robot=robot), payload, attachment=payload[:80])
    lease = server.hli.core.leases.of("fr")
    assert lease is not None
    key = topics.INCREMENT.key("small", robot="fr")
    session.put(key, payload, attachment=Prover(lease.token).prove(key, payload))  # read, as a holder's
    for topic in (topics.LEASE, topics.IO, topics.RESET, topics.STATUS):
        replies = list(session.get(topic.key("small", robot="fr"), payload=payload, timeout=300))
        assert len(replies) == 1, topic.name
    status = server.hli.status()
    assert "failed" not in status.hli
    assert server.errors == []
    assert server.peer.increments.empty()
