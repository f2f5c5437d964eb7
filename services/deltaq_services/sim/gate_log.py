"""The gate's own log of its inputs and outputs, in its order, for a recorder.

A second listener hears the same messages, but not in the order in which the gate took them, and
that order decides. No entry is written while nobody listens; a listener that is too slow loses entries,
which their numbers show, and never delays the gate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import zenoh

from deltaq_protocol import topics
from deltaq_protocol.codec import pack
from deltaq_protocol.guarded import GateEntry
from deltaq_protocol.topics import Topic
from deltaq_services.sim.core import Sim

MEMORY_PERIOD = 500
"""Messages between two snapshots, at which a replay can begin, or continue after a gap."""


class GateLog:
    """Publishes the log on the SIM's session."""

    def __init__(self, session: Any, cell: str, sim: Sim) -> None:
        self._sim = sim
        self._listened_to = False
        self._entries = _publisher(session, topics.GATE_LOG.key(cell))
        self._memories = _publisher(session, topics.GATE_MEMORY.key(cell))

    def took(self, topic: Topic, payload: bytes, outputs: Sequence[tuple[str, bytes]]) -> None:
        """The gate took a message and published its outputs, all as msgpack."""
        began = not self._listened_to
        self._listened_to = self._entries.matching_status.matching
        if not self._listened_to:
            return
        sim = self._sim
        if not began:
            entry = GateEntry(
                epoch=sim.epoch, number=sim.taken, topic=topic.name, payload=payload, outputs=tuple(outputs)
            )
            self._entries.put(pack(entry))
        if began or sim.taken % MEMORY_PERIOD == 0:
            self._memories.put(pack(sim.memory()))


def _publisher(session: Any, key: str) -> Any:
    # the SIM itself listens to all of its realm, and does not count
    return session.declare_publisher(
        key,
        priority=zenoh.Priority.DATA,
        congestion_control=zenoh.CongestionControl.DROP,
        allowed_destination=zenoh.Locality.REMOTE,
    )
