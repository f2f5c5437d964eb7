"""The HLI in the guarded realm: a peer of the SIM and of every Robot Server."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable

import zenoh

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.access import access
from deltaq_protocol.codec import unpack
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.guarded import CommandReply, Health, ServerState
from deltaq_protocol.messages import Message, Verdict
from deltaq_protocol.seal import ForgedMessageError
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Party, Realm, Topic
from deltaq_services.guarded_key import guarded_seal
from deltaq_services.hli.port import Port
from deltaq_services.hli.zenoh_session import LoopSession
from deltaq_services.outputs import Output

_log = logging.getLogger(__name__)


class GuardedFront:
    """Takes states, verdicts and replies; publishes requests and commands.

    It connects to every Robot Server and to the SIM, and again whenever one of them is lost.

    Raises:
        GuardedKeyError: if the realm leaves the loopback, and there is no key.
    """

    def __init__(self, cell: CellDescription, port: Port) -> None:
        self._cell = cell.cell
        self._port = port
        endpoints = [robot.server for robot in cell.robots.values()] + [cell.sim]
        self._seal = guarded_seal(cell)
        rules = access(Party.HLI, Realm.GUARDED, cell.cell)
        self._session = LoopSession(
            open_session(connect=endpoints, access=rules), cell.cell, port.loop, self._seal
        )
        self._session.subscribe(topics.SERVER_STATE, self._on_state)
        self._session.subscribe(topics.GATE_VERDICT, self._on_verdict)
        self._session.subscribe(topics.COMMAND_REPLY, self._on_command_reply)
        self._session.subscribe(topics.HEALTH, self._on_health)

    def publish(self, topic: Topic, robot: str, message: Message) -> None:
        """Publish a message in the guarded realm."""
        self._session.publish(topic, message, robot=robot, service="hli")

    def counters(self) -> Counter[str]:
        """What the session counted."""
        return self._session.counters()

    def close(self) -> None:
        """Leave the guarded realm."""
        self._session.close()

    def _on_state(self, sample: zenoh.Sample) -> None:
        self._take(
            sample, lambda data: self._port.core.on_server_state(unpack(ServerState, data), self._port.now())
        )

    def _on_verdict(self, sample: zenoh.Sample) -> None:
        self._take(sample, lambda data: self._port.core.on_gate_verdict(unpack(Verdict, data)))

    def _on_command_reply(self, sample: zenoh.Sample) -> None:
        self._take(sample, lambda data: self._port.core.on_command_reply(unpack(CommandReply, data)))

    def _on_health(self, sample: zenoh.Sample) -> None:
        self._take(sample, lambda data: self._port.core.on_health(unpack(Health, data), self._port.now()))

    def _take(self, sample: zenoh.Sample, decide: Callable[[bytes], list[Output]]) -> None:
        try:
            outputs = decide(self._seal.open(str(sample.key_expr), sample.payload.to_bytes()))
        except ForgedMessageError as error:
            self._port.core.counters["forged_guarded"] += 1
            if self._port.core.counters["forged_guarded"] == 1:
                _log.warning("the first forged message: %s", error)
            return
        except ProtocolError as error:
            self._port.core.counters["malformed_guarded"] += 1
            _log.warning("%s: %s", sample.key_expr, error)
            return
        self._port.carry_out(outputs)
