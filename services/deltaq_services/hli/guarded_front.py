"""The HLI in the guarded realm: a peer of the SIM and of every Robot Server."""

from __future__ import annotations

import logging
from collections import Counter
from functools import partial

import zenoh

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.envelope import Envelopes, StaleMessageError
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.messages import Message
from deltaq_protocol.sayings import HLI, SIM, robot_server
from deltaq_protocol.topic import Party, Topic
from deltaq_services.guarded_realm import open_guarded_session
from deltaq_services.hli.port import Port
from deltaq_services.hli.zenoh_session import LoopSession

_log = logging.getLogger(__name__)


class GuardedFront:
    """Takes states, verdicts and replies; publishes requests and commands.

    It connects to every Robot Server and to the SIM, and again whenever one of them is lost.

    Raises:
        GuardedRealmError: an endpoint lets strangers in.
        RuntimeFolderError: the folder of the sockets is not this user's alone.
    """

    def __init__(self, cell: CellDescription, port: Port) -> None:
        self._cell, self._robots = cell.cell, tuple(cell.robots)
        self._port = port
        self._envelopes = Envelopes(HLI, cell.cell, self._robots)
        services = [*map(robot_server, self._robots), SIM]
        session = open_guarded_session(cell, Party.HLI, HLI, connect=services)
        self._session = LoopSession(session, cell.cell, port.loop, self._envelopes)
        for topic in (topics.SERVER_STATE, topics.GATE_VERDICT, topics.COMMAND_REPLY, topics.HEALTH):
            self._session.subscribe(topic, partial(self._take, topic.message))

    def publish(self, topic: Topic, robot: str, message: Message) -> None:
        """Publish a message in the guarded realm."""
        self._session.publish(topic, message, robot=robot, service=HLI)

    def counters(self) -> Counter[str]:
        """What the session counted."""
        return self._session.counters()

    def close(self) -> None:
        """Leave the guarded realm."""
        self._session.close()

    def _take(self, message_type: type[Message], sample: zenoh.Sample) -> None:
        try:
            opened = self._envelopes.open(str(sample.key_expr), sample.payload.to_bytes())
            message = unpack(message_type, opened)
        except StaleMessageError:
            self._port.core.counters["stale_guarded"] += 1
            return
        except ProtocolError as error:
            self._port.core.counters["malformed_guarded"] += 1
            _log.warning("%s: %s", sample.key_expr, error)
            return
        robot = getattr(message, "robot", "")  # of a state or a verdict
        robots = (robot,) if robot in self._robots else ()
        self._port.serve(lambda: self._port.core.take(message, self._port.now()), robots)
