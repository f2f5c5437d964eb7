"""The gate's own log of its inputs and outputs, in its order, for a recorder.

A second listener hears the same messages, but not in the order in which the gate took them, and
that order decides. No entry is written while nobody listens; a listener that is too slow loses entries,
which their numbers show, and never delays the gate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from deltaq_protocol import topics
from deltaq_protocol.codec import pack
from deltaq_protocol.guarded import GateEntry
from deltaq_protocol.session import declare_publisher
from deltaq_protocol.topic import Messages, Topic
from deltaq_services.sim.core import Sim


def memory_is_due(sim: Sim) -> bool:
    """Whether a memory follows the newest message: where a replay can begin, or go on after a gap.

    One follows each message that was refused after an error: a replay that meets no such error tells the difference,
    and goes on from there.
    """
    rate = topics.GATE_MEMORY.rate
    assert isinstance(rate, Messages)  # that is how the table counts them
    return sim.containment.failed or sim.taken % rate.messages == 0


class GateLog:
    """Publishes the log on the SIM's session."""

    def __init__(self, session: Any, cell: str, sim: Sim) -> None:
        self._sim = sim
        self._listened_to = False
        self._entries = _publisher(session, topics.GATE_LOG, cell)
        self._memories = _publisher(session, topics.GATE_MEMORY, cell)

    def look_for_listeners(self) -> None:
        """See whether anybody listens; to be called between messages, and now and then, since it takes its time.

        Who has come gets a snapshot, and every message after it.
        """
        began = not self._listened_to
        self._listened_to = self._entries.matching_status.matching
        if began and self._listened_to:
            self._memories.put(pack(self._sim.snapshot()))

    def begin_anew(self) -> None:
        """Give listeners a snapshot when they are looked for next: not only messages have changed the gate."""
        self._listened_to = False

    def took(self, topic: Topic, payload: bytes, outputs: Sequence[tuple[str, bytes]]) -> None:
        """The gate took a message and published its outputs, all as msgpack."""
        if not self._listened_to:
            return
        sim = self._sim
        entry = GateEntry(
            epoch=sim.epoch, number=sim.taken, topic=topic.name, payload=payload, outputs=tuple(outputs)
        )
        self._entries.put(pack(entry))
        if memory_is_due(sim):
            self._memories.put(pack(sim.snapshot()))


def _publisher(session: Any, topic: Topic, cell: str) -> Any:
    # the SIM itself listens to all of its realm, and does not count
    return declare_publisher(session, topic.key(cell), priority=topic.priority, to_itself=False)
