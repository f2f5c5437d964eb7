"""The HLI in the guarded realm: a peer of the SIM and of every Robot Server."""

from __future__ import annotations

import logging
from collections import Counter
from functools import partial

import zenoh

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.messages import Message
from deltaq_protocol.sayings import HLI
from deltaq_protocol.seal import ForgedMessageError, UnboundMessageError
from deltaq_protocol.topic import Party, Topic
from deltaq_services.greeter import Greeter
from deltaq_services.guarded_key import guarded_seal
from deltaq_services.guarded_session import open_guarded_session
from deltaq_services.hli.port import Port
from deltaq_services.hli.zenoh_session import LoopSession

_log = logging.getLogger(__name__)


class GuardedFront:
    """Takes states, verdicts and replies; publishes requests and commands.

    It connects to every Robot Server and to the SIM, and again whenever one of them is lost.

    Raises:
        GuardedKeyError: if there is no key.
    """

    def __init__(self, cell: CellDescription, port: Port) -> None:
        self._cell, self._robots = cell.cell, tuple(cell.robots)
        self._port = port
        endpoints = [robot.server for robot in cell.robots.values()] + [cell.sim]
        self._seal = guarded_seal(cell, HLI)
        session = open_guarded_session(cell, Party.HLI, HLI, connect=endpoints)
        self._session = LoopSession(session, cell.cell, port.loop, self._seal)
        for topic in (topics.SERVER_STATE, topics.GATE_VERDICT, topics.COMMAND_REPLY, topics.HEALTH):
            self._session.subscribe(topic, partial(self._take, topic.message))
        self._session.subscribe(topics.GREETING, self._meet)
        self._greeter = Greeter(HLI, partial(self._session.greet, topics.GREETING, service=HLI))

    def publish(self, topic: Topic, robot: str, message: Message) -> None:
        """Publish a message in the guarded realm."""
        self._session.publish(topic, message, robot=robot, service=HLI)

    def counters(self) -> Counter[str]:
        """What the session counted."""
        counters = self._session.counters()
        counters["newcomers_passed_over"] = self._seal.passed_over
        return counters

    def close(self) -> None:
        """Leave the guarded realm."""
        self._session.close()

    def _take(self, message_type: type[Message], sample: zenoh.Sample) -> None:
        try:
            opened = self._seal.open(str(sample.key_expr), sample.payload.to_bytes())
            message = unpack(message_type, opened)
        except ForgedMessageError as error:
            self._count_forged(error)
            return
        except UnboundMessageError:
            self._port.core.counters["unbound_guarded"] += 1
            self._greeter.greet(self._port.now())
            return
        except ProtocolError as error:
            self._port.core.counters["malformed_guarded"] += 1
            _log.warning("%s: %s", sample.key_expr, error)
            return
        robot = getattr(message, "robot", "")  # of a state or a verdict
        robots = (robot,) if robot in self._robots else ()
        self._port.serve(lambda: self._port.core.take(message, self._port.now()), robots)

    def _meet(self, sample: zenoh.Sample) -> None:
        try:
            if not self._seal.meet(str(sample.key_expr), sample.payload.to_bytes()):
                self._port.core.counters["unbound_guarded"] += 1
        except ForgedMessageError as error:
            self._count_forged(error)

    def _count_forged(self, error: ForgedMessageError) -> None:
        counters = self._port.core.counters
        counters["forged_guarded"] += 1
        if counters["forged_guarded"] == 1:
            _log.warning("the first forged message: %s", error)
