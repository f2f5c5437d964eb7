"""A stranger in the open realm: a zenoh session without any credential, at the HLI's own port."""

import json
import queue
from typing import Any

import zenoh

from deltaq_protocol import topics
from deltaq_protocol.codec import pack
from deltaq_protocol.messages import DescribeRequest, Message


class OpenStranger:
    """Hears whatever it can and answers every question, as the server would.

    Args:
        where: the HLI's endpoint.
        cell: name of the cell.
        mode: of zenoh's sessions: `client`, `peer` or `router`.
        answers: whether it answers what is asked of the server.
    """

    def __init__(self, where: str, cell: str, mode: str = "client", answers: bool = True) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", json.dumps(mode))
        config.insert_json5("connect/endpoints", json.dumps([where]))
        config.insert_json5("listen/endpoints", "[]")
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session: Any = zenoh.open(config)
        self._cell = cell
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.asked: list[bytes] = []
        elsewhere = {"allowed_origin": zenoh.Locality.REMOTE}
        self.session.declare_subscriber("**", self._queue.put, **elsewhere)
        if answers:
            self.session.declare_queryable("**", self._answer, **elsewhere)

    def say(self, topic: topics.Topic, message: Message, proof: bytes | None = None, **fields: str) -> None:
        """Publish, and return when the HLI has read it."""
        block = zenoh.CongestionControl.BLOCK
        key = topic.key(self._cell, **fields)
        self.session.put(key, pack(message), attachment=proof, congestion_control=block)
        self.wait()

    def ask(self, topic: topics.Topic, message: Message, proof: bytes | None = None, robot: str = "") -> Any:
        """The one answer to a query."""
        key = topic.key(self._cell, robot=robot)
        (reply,) = self.session.get(key, payload=pack(message), attachment=proof, timeout=300.0)
        return reply

    def wait(self) -> None:
        """Return when the HLI has read all that was said."""
        assert self.ask(topics.STATUS, DescribeRequest()).ok is not None

    def heard(self, until: bytes) -> list[bytes]:
        """What came, payloads and attachments, up to one that has `until` in it."""
        heard: list[bytes] = []
        while not heard or until not in heard[-1]:
            sample = self._queue.get(timeout=300.0)
            beside = sample.attachment.to_bytes() if sample.attachment else b""
            heard.append(beside + sample.payload.to_bytes())
        return heard + self.asked

    def close(self) -> None:
        self.session.close()

    def _answer(self, query: Any) -> None:
        beside = query.attachment.to_bytes() if query.attachment else b""
        self.asked.append(beside + (query.payload.to_bytes() if query.payload else b""))
        with query:
            query.reply(query.key_expr, b"forged")
