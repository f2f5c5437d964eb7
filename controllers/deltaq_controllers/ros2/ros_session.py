"""The bridge's zenoh session in the ROS graph: a node, publishers and subscriptions as rmw_zenoh would declare them."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any, Self

import zenoh

from deltaq_controllers.ros2.messages import MAX_MESSAGE_BYTES
from deltaq_controllers.ros2.rmw import RosAttachment, RosEndpoint, RosNode, RosType
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.wire import Wire

_STATES_KEPT = 10
_TRAJECTORIES_KEPT = 4
"""Messages that may wait to be served; the newest stay."""


class RosSession:
    """A separate session, only to a router of ROS; it neither listens nor scouts.

    Its mode is `client`: between two peers rmw_zenoh's router does not hand on what they send, between a client and
    others it does.

    Args:
        session: of zenoh, open; `join` opens one.
        domain_id: of ROS.
        namespace: of the node, e.g. `/lab`.
        name: of the node.
    """

    def __init__(self, session: Any, domain_id: int, namespace: str, name: str) -> None:
        self._session = session
        self._wire = Wire(session, asyncio.get_running_loop())
        self._node = RosNode(domain_id, str(session.zid()), namespace, name)
        self._tokens: list[Any] = []
        self._declared = 0
        self._show(self._node.token)

    @classmethod
    async def join(cls, endpoint: str, domain_id: int, namespace: str, name: str) -> Self:
        """Join the graph behind the router at `endpoint`, e.g. `tcp/127.0.0.1:7448`.

        Raises:
            ServiceUnreachableError: no router answers there.
        """
        return cls(await asyncio.to_thread(_opened, endpoint), domain_id, namespace, name)

    def publisher(self, topic: str, kind: RosType) -> RosPublisher:
        """Declare a publisher of a topic, e.g. `/lab/fr/joint_states`."""
        self._declared += 1
        endpoint = self._node.publisher(self._declared, topic, kind, _STATES_KEPT)
        publisher = self._session.declare_publisher(
            endpoint.key, congestion_control=zenoh.CongestionControl.DROP
        )
        self._show(endpoint.token)
        return RosPublisher(publisher, endpoint)

    def subscribe(self, topic: str, kind: RosType, take: Callable[[bytes, bytes | None], None]) -> None:
        """Call `take` in the loop with messages of a topic, and what is attached to them."""
        self._declared += 1
        endpoint = self._node.subscription(self._declared, topic, kind, _TRAJECTORIES_KEPT)

        def serve(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            take(sample.payload.to_bytes(), None if attachment is None else attachment.to_bytes())

        self._wire.subscribe(endpoint.key, serve, _TRAJECTORIES_KEPT)
        self._show(endpoint.token)

    async def leave(self) -> None:
        """Leave the graph."""
        await asyncio.to_thread(self._close)

    def _close(self) -> None:
        while self._tokens:
            self._tokens.pop().undeclare()
        self._wire.close()

    def _show(self, token: str) -> None:
        self._tokens.append(self._session.liveliness().declare_token(token))


class RosPublisher:
    """Publishes messages, each with what rmw_zenoh attaches."""

    def __init__(self, publisher: Any, endpoint: RosEndpoint) -> None:
        self._publisher, self._gid = publisher, endpoint.gid
        self.published = 0

    def publish(self, message: bytes) -> None:
        """Publish a message in CDR; while the router is gone it is dropped."""
        self.published += 1
        attachment = RosAttachment(self.published, time.time_ns(), self._gid)
        self._publisher.put(message, attachment=attachment.encode())


def _opened(endpoint: str) -> Any:
    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 2000,
        "connect/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/rx/max_message_size": 2
        * MAX_MESSAGE_BYTES,  # a message that is too long gets an answer
    }.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        raise ServiceUnreachableError(
            f"no zenoh router answers at {endpoint}; is it up (`ros2 run rmw_zenoh_cpp rmw_zenohd`), and the address "
            "that of --ros-endpoint?"
        ) from None
