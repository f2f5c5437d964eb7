"""zenoh sessions with explicit endpoints: no process joins by accident, nothing queues up.

Multicast scouting and gossip are off, a lost peer is found again within a fraction of a second, and a
message is small. Urgent messages travel express, at real-time priority; streams are dropped rather than queued. With
a UDP link beside the TCP link (`tcp+udp/`), urgent streams use UDP.
"""

import json
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh

from deltaq_protocol.codec import MAX_ZENOH_MESSAGE_BYTES
from deltaq_protocol.envelope import Envelopes
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.topic import Priority

MAX_SESSIONS = 64
"""Peers that one session serves; a further peer has to wait until another leaves."""
_WAITING_TO_BE_SENT = 16
"""Urgent messages that may wait for a link to be served, the most that zenoh allows. With its own two, every
millisecond in which a busy machine kept the link's thread waiting cost verdicts and states."""
LINK_LEASE_MS = 1000
"""A peer that is silent for this time is lost; it misses messages until it is found again."""
_ACCEPT_MS = 1000
"""Silent connections are closed after this: until then they keep others waiting."""
_OPEN_MS = 3000
"""A firewall may swallow datagrams: their link is given up after this, and tried again. No session closes meanwhile."""


_SHARED_THREADS = (
    "(app: (worker_threads: 2), rx: (handover: app), acc: (handover: app), net: (handover: app))"
)
"""zenoh's threads, as its environment variable has them: those that accept and connect would wake others to read."""
THREADS = "ZENOH_RUNTIME"
"""Environment variable of zenoh's threads; it has no effect once a session is open."""


def open_session(
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    must_connect: bool = False,
    access: Mapping[str, Any] | None = None,
    tls: Mapping[str, Any] | None = None,
) -> Any:
    """Open a zenoh session.

    Args:
        listen: endpoints to listen on, e.g. `tcp/127.0.0.1:7447`.
        connect: endpoints to connect to; lost connections are made again.
        must_connect: fail at once if an endpoint cannot be reached, instead of trying for ever.
        access: permissions from `deltaq_protocol.access`; None: every peer may send every topic.
        tls: certificates of `tls/` endpoints, as zenoh's configuration has them.

    Raises:
        ServiceUnreachableError: if an endpoint can neither be listened on nor, with `must_connect`, reached.
    """
    os.environ.setdefault(THREADS, _SHARED_THREADS)
    settings: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": [link for text in listen for link in _links(text)],
        "connect/endpoints": [link for text in connect for link in _links(text)],
        "connect/timeout_ms": 2000 if must_connect else -1,
        "connect/exit_on_failure": must_connect,
        "connect/retry": {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 1.5},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # no scouting, so no peer to wait for
        "transport/shared_memory/enabled": False,  # our messages are too short for it, and it wants locked memory
        "transport/link/tx/lease": LINK_LEASE_MS,
        "transport/link/tx/queue/size/real_time": _WAITING_TO_BE_SENT,
        "transport/link/rx/max_message_size": MAX_ZENOH_MESSAGE_BYTES,
        "transport/unicast/max_sessions": MAX_SESSIONS,
        "transport/unicast/accept_timeout": _ACCEPT_MS,
    }
    if any(_has_datagrams(text) for text in (*listen, *connect)):
        settings["transport/unicast/max_links"] = 2
        settings["transport/unicast/open_timeout"] = _OPEN_MS
        settings["timestamping/enabled"] = True  # a datagram may overtake another
    if tls is not None:
        settings["transport/link/tls"] = tls
    if access is not None:
        settings["access_control"] = access
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if connect and must_connect:
            raise ServiceUnreachableError(
                f"no server answers at {', '.join(connect)}; is the cell up (`deltaq up`), the address right, "
                f"and fewer than {MAX_SESSIONS} others there?"
            ) from error
        # zenoh appends a line of its own source
        why = re.sub(r" at \S+\.rs:\d+\.?", "", str(error))
        raise ServiceUnreachableError(f"cannot listen on {', '.join(listen)}: {why}") from error


def _has_datagrams(text: str) -> bool:
    return text.startswith("tcp+udp/")


def _links(text: str) -> tuple[str, ...]:
    """The links of an endpoint, as zenoh names them; `rel` selects the messages of each of two links."""
    if not _has_datagrams(text):
        return (text,)
    place = text.partition("/")[2]
    # without its link of datagrams a session has all over the other one
    return f"tcp/{place}?rel=1", f"udp/{place}?rel=0#exit_on_failure=false"


class EnvelopePublisher:
    """Publishes messages in envelopes."""

    def __init__(self, publisher: Any, key: str, envelopes: Envelopes) -> None:
        self._publisher, self._key, self._envelopes = publisher, key, envelopes

    def put(self, message: bytes) -> None:
        """Enclose a message and publish it."""
        self._publisher.put(self._envelopes.close(self._key, message))


def sending(priority: Priority) -> dict[str, Any]:
    """Options with which zenoh sends messages of a priority."""
    urgent = priority is Priority.URGENT
    return {
        "express": urgent,
        "priority": zenoh.Priority.REAL_TIME if urgent else zenoh.Priority.DATA,
    }


def declare_publisher(
    session: Any,
    key: str,
    envelopes: Envelopes | None = None,
    priority: Priority = Priority.URGENT,
    to_itself: bool = True,
) -> Any:
    """A publisher for small messages, dropped when blocked. Its own session does not receive enclosed messages.

    Args:
        session: an open zenoh session.
        key: zenoh key to publish on.
        envelopes: encloses the messages; None in the open realm, and for messages that are only recorded.
        priority: as in its row of the table of topics; urgent messages are sent at once.
        to_itself: whether subscribers of this session receive the messages too.
    """
    is_local = to_itself and envelopes is None
    urgent = priority is Priority.URGENT
    publisher = session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        # where there are two links it says which: over that of datagrams none waits behind one that was lost
        reliability=zenoh.Reliability.BEST_EFFORT if urgent else zenoh.Reliability.RELIABLE,
        allowed_destination=zenoh.Locality.ANY if is_local else zenoh.Locality.REMOTE,
        **sending(priority),
    )
    return publisher if envelopes is None else EnvelopePublisher(publisher, key, envelopes)


def subscribe_newest(session: Any, key: str, capacity: int = 1) -> Any:
    """A subscriber that keeps the newest `capacity` samples, to be read with `try_recv` or `recv`."""
    return session.declare_subscriber(key, zenoh.handlers.RingChannel(capacity))
