"""The HLI in the guarded realm: a peer of the SIM and of every Robot Server."""

from __future__ import annotations

import logging
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

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
from deltaq_services.hli.zenoh_session import HliSession
from deltaq_services.outputs import Output

if TYPE_CHECKING:
    from deltaq_services.hli.shell import Hli

_log = logging.getLogger(__name__)


class GuardedFront:
    """Takes states, verdicts and replies; publishes requests and commands.

    It connects to every Robot Server and to the SIM, and again whenever one of them is lost.

    Raises:
        GuardedRealmError: an endpoint is open to other users.
        RuntimeFolderError: the folder of the sockets is not this user's alone.
    """

    def __init__(self, cell: CellDescription, port: Hli) -> None:
        robots = tuple(cell.robots)
        streams = topics.SERVER_STATE, topics.GATE_VERDICT
        self._concerned = {
            stream.key(cell.cell, robot=robot): (robot,) for stream in streams for robot in robots
        }
        self._port = port
        self._envelopes = Envelopes(HLI, cell.cell, robots)
        services = [*map(robot_server, robots), SIM]
        session = open_guarded_session(cell, Party.HLI, HLI, connect=services)
        self._session = HliSession(session, cell.cell, port.loop, self._envelopes)
        for topic in (*streams, topics.COMMAND_REPLY, topics.HEALTH):
            self._session.subscribe(topic, partial(self._take, topic.message))

    def publish(self, topic: Topic, robot: str, message: Message) -> None:
        """Publish a message in the guarded realm."""
        self._session.publish(topic, message, robot=robot, service=HLI)

    def counters(self) -> Counter[str]:
        """Counters of the session."""
        return self._session.counters()

    def close(self) -> None:
        """Leave the guarded realm."""
        self._session.close()

    def _take(self, message_type: type[Message], sample: zenoh.Sample) -> None:
        key, port = str(sample.key_expr), self._port
        robots = self._concerned.get(key, ())
        port.serve(lambda: self._judged(message_type, key, sample.payload.to_bytes()), robots)

    def _judged(self, message_type: type[Message], key: str, payload: bytes) -> list[Output]:
        core = self._port.core
        try:
            message = unpack(message_type, self._envelopes.open(key, payload))
        except StaleMessageError:
            core.counters["stale_guarded"] += 1
            return []
        except ProtocolError as error:
            core.counters["malformed_guarded"] += 1
            _log.warning("%s: %s", key, error)
            return []
        return core.take(message, self._port.now())
