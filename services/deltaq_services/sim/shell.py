"""The loop of the SIM: one blocking read of a ring channel, decide, publish.

There is one Python thread and one channel for everything that comes in, so nothing is decided out of turn.
Robot Servers and the HLI give heartbeats at the pace that the table of topics sets, so the loop never sleeps for
long.
"""

import logging
import math
import secrets
import time
from collections.abc import Sequence
from typing import Any

import zenoh

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.envelope import Envelopes, MisaddressedError, StaleMessageError
from deltaq_protocol.guarded import Admission, GateEntry, Health, Request
from deltaq_protocol.heartbeat import Heartbeat
from deltaq_protocol.messages import Message, Outcome, Verdict
from deltaq_protocol.sayings import SIM, robot_server
from deltaq_protocol.session import declare_publisher
from deltaq_protocol.stamps import Stamps, StampStation, stamps_if_asked
from deltaq_protocol.topic import Party, Realm, Topic
from deltaq_services.guarded_realm import guarded_links, open_guarded_session
from deltaq_services.rate_limit import Pace
from deltaq_services.sim.core import Decider, Sim
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.orders import SparedSupervision
from deltaq_services.sim.tracker import Tracker


class GateLog:
    """The gate's own log of its inputs and outputs, in its order, for a recorder.

    A second listener hears the same messages, but not in the order in which the gate took them, and
    that order decides. Without a listener no entry is written; a listener that is too slow loses entries, as their
    numbers show, and never delays the gate.
    """

    def __init__(self, session: Any, cell: str, sim: Sim) -> None:
        self._sim = sim
        self._listened_to = False
        self._entries = _publisher(session, topics.GATE_LOG, cell)
        self._memories = _publisher(session, topics.GATE_MEMORY, cell)

    def look_for_listeners(self) -> None:
        """Check for listeners; to be called between messages, and not often, since it is slow.

        A new listener gets a snapshot, and every message after it.
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
        if sim.memory_is_due:
            self._memories.put(pack(sim.snapshot()))


def _publisher(session: Any, topic: Topic, cell: str) -> Any:
    # the SIM itself listens to all of its realm, and does not count
    return declare_publisher(session, topic.key(cell), priority=topic.priority, to_itself=False)


class GateStamps:
    """Stamps received requests, begin and end of each decision, and sent admissions.

    Taken only if the environment asks for them; see `deltaq_protocol.stamps`.

    Args:
        stamps: receives the stamps.
        sim: the SIM whose gate is watched; its decisions do not change.
    """

    def __init__(self, stamps: Stamps, sim: Sim) -> None:
        self._stamps = stamps
        self._watched = sim.gate = _Watched(sim.gate)

    def came(self, message: Message) -> None:
        """Stamp a message that the gate is about to take."""
        if isinstance(message, Request) and message.dq is not None:
            self._stamps.add(StampStation.REQUEST_AT_GATE, message.robot, message.cycle, message.seq)

    def went(self, message: Message) -> None:
        """Stamp a published message of the gate: of a decision first the admission, if any, then the verdict."""
        if isinstance(message, Admission):
            self._stamps.add(StampStation.ADMISSION_OUT, message.robot, message.cycle)
        elif isinstance(message, Verdict) and message.outcome is not Outcome.REFUSED:
            robot, cycle, seq, watched = message.robot, message.cycle, message.seq, self._watched
            self._stamps.add(StampStation.DECISION_BEGUN, robot, cycle, seq, watched.begun_ns)
            self._stamps.add(StampStation.DECIDED, robot, cycle, seq, watched.decided_ns)


class _Watched:
    """A gate, and when its last decision began and ended [ns]."""

    def __init__(self, gate: Decider) -> None:
        self._gate = gate
        self.begun_ns = self.decided_ns = 0

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        self.begun_ns = time.monotonic_ns()
        decision = self._gate.decide(robot, others, request)
        self.decided_ns = time.monotonic_ns()
        return decision


_log = logging.getLogger(__name__)

_RING = 256
"""Messages that may wait; two robots and the HLI send six a cycle. A gate that was kept waiting for half a second
still answers every request, if only to say that it is stale."""
_INTRODUCTION_PERIOD_S = 0.01
"""Between two heartbeats that tell an HLI which process the gate is."""
_LOG_PERIOD_S = 1.0
"""States that the gate cannot have caused may come in every cycle."""


def _taken() -> dict[str, Topic]:
    """What the SIM takes in, by the end of the key; others' heartbeats only wake it.

    Entries of the audit log it hands on to recorders; the gate does not hear of them.
    """
    rows = [topic for topic in topics.TOPICS if topic.realm is Realm.GUARDED and Party.SIM in topic.readers]
    return {topic.template.rpartition("/")[2]: topic for topic in rows if topic.message is not Health}


class Shell:
    """The SIM's session and the core behind it."""

    def __init__(self, cell: CellModel) -> None:
        description = cell.description
        self._name = description.cell
        self._identity = cell.identity
        guarded_links(description)  # a wrong endpoint is reported before the gate is made, which is slow
        self.sim = Sim(cell, epoch=secrets.randbits(62))
        stamps = stamps_if_asked("sim", list(description.robots))
        self._stamps = None if stamps is None else GateStamps(stamps, self.sim)
        robots = tuple(description.robots)
        self._envelopes = Envelopes(SIM, self._name, robots)
        servers = [robot_server(robot) for robot in robots]
        self._session: Any = open_guarded_session(description, Party.SIM, SIM, listen=[SIM], connect=servers)
        self._taken = _taken()
        self._incoming = self._session.declare_subscriber(
            f"deltaq-guarded/{self._name}/**",
            zenoh.handlers.RingChannel(_RING),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self._spared = SparedSupervision(math.ceil(description.gate.gate_timeout_s / description.cycle_s))
        self._log = GateLog(self._session, self._name, self.sim)
        audit = topics.AUDIT.key(self._name)
        self._audit = declare_publisher(self._session, audit, priority=topics.AUDIT.priority)
        self._publishers: dict[tuple[str, str], Any] = {}
        self._pace = Pace(topics.HEALTH.period_s(description.cycle_s))
        self._introduction_pace = Pace(_INTRODUCTION_PERIOD_S)
        self._log_pace = Pace(_LOG_PERIOD_S)
        self._heartbeat = Heartbeat()
        for topic in (topics.SUPERVISION, topics.ADMISSION, topics.GATE_VERDICT):
            for robot in description.robots:
                self._publisher(topic, robot)

    def run(self) -> None:
        """Serve until the process is ended by a signal."""
        try:
            while True:
                sample = self._incoming.recv()
                try:
                    self._handle(str(sample.key_expr), sample.payload.to_bytes())
                    self._say_healthy()
                except Exception as error:  # no error may end the gate; an unsent message counts as lost
                    self.sim.containment.note(error)
                    self.sim.hold_all()
                    self._log.begin_anew()
                self.sim.containment.log_once(_log)
        finally:
            self._heartbeat.close()
            self._session.close()

    def _handle(self, key: str, payload: bytes) -> None:
        topic = self._taken.get(key.rpartition("/")[2])
        try:
            payload = self._envelopes.open(key, payload)
            if topic is None:
                return  # a heartbeat of the others
            message = unpack(topic.message, payload)
        except StaleMessageError as error:
            self.sim.counters["stale_messages"] += 1
            if isinstance(error, MisaddressedError) and self._introduction_pace.due(time.monotonic()):
                self._publish_health(time.monotonic())  # its sender learns which process the gate is
            return
        except InvalidMessageError as error:
            self.sim.counters["invalid_messages"] += 1
            _log.warning("%s: %s", key, error)
            return
        if topic is topics.AUDIT_ENTRY:
            self._audit.put(payload)
            return
        if self._stamps is not None:
            self._stamps.came(message)
        outputs = []
        disbelieved = self.sim.disbelieved
        taken = self.sim.take(message)
        if self.sim.disbelieved != disbelieved and self._log_pace.due(time.monotonic()):
            _log.error("all robots are stopped: %s", self.sim.disbelieved)
        for output in taken:
            packed = pack(output.message)
            if not self._spared.spares(output.message):
                self._publisher(output.topic, output.robot).put(packed)
            outputs.append((output.topic.name, packed))
            if self._stamps is not None:
                self._stamps.went(output.message)
        self._log.took(topic, payload, outputs)

    def _publisher(self, topic: Topic, robot: str = "") -> Any:
        publisher = self._publishers.get((topic.name, robot))
        if publisher is None:
            key = topic.key(self._name, robot=robot, service=SIM)
            publisher = declare_publisher(self._session, key, self._envelopes, topic.priority)
            self._publishers[topic.name, robot] = publisher
        return publisher

    def _say_healthy(self) -> None:
        now_s = time.monotonic()
        if not self._pace.due(now_s):
            return
        self._log.look_for_listeners()
        self._publish_health(now_s)
        self._heartbeat.beat(now_s, detail=self.sim.disbelieved)

    def _publish_health(self, now_s: float) -> None:
        health = Health(
            service=SIM,
            healthy=True,
            detail=self.sim.disbelieved,
            time_s=now_s,
            counters=dict(self.sim.counters),
            nearest=self.sim.nearest(),
            fingerprint=self.sim.fingerprint,
            contacts=self.sim.contacts.allowed,
            cell=str(self._identity),
            epoch=self.sim.epoch,
            newest_id=self.sim.newest_id,
        )
        self._publisher(topics.HEALTH).put(pack(health))
