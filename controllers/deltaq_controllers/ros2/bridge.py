"""The bridge's shell: a client of the HLI on one side, a node in the ROS graph on the other."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import zenoh

from deltaq_controllers.answers import Answers, lease
from deltaq_controllers.ros2.messages import (
    JOINT_STATE,
    JOINT_TRAJECTORY,
    MAX_MESSAGE_BYTES,
    JointStates,
    RosType,
)
from deltaq_controllers.ros2.mover import TrajectoryMover
from deltaq_controllers.ros2.rmw import (
    RosAttachment,
    RosEndpoint,
    RosNode,
    checked_domain_id,
    checked_namespace,
    ros_name,
)
from deltaq_protocol.client import Cell, connect
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.wire import Wire

# The bridge's zenoh session in the ROS graph: a node, publishers and subscriptions as rmw_zenoh would declare them.


_STATES_KEPT = 10
_TRAJECTORIES_KEPT = 4
"""Messages that may wait to be served; the newest stay."""


class RosSession:
    """A separate session, only to a router of ROS; it neither listens nor scouts.

    Its mode is `client`: rmw_zenoh's router forwards no messages between two peers, but between a client and others.

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
        """Call `take` in the loop with each message of a topic and its attachment."""
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
    """Publishes messages, each with rmw_zenoh's attachment."""

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
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": 2
        * MAX_MESSAGE_BYTES,  # a message that is too long gets an answer
    }.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        raise ServiceUnreachableError(
            f"no zenoh router answers at {endpoint}; is it up (`ros2 run rmw_zenoh_cpp rmw_zenohd`), "
            "and is --ros-endpoint its address?"
        ) from None


_log = logging.getLogger(__name__)

DEFAULT_ROS_ENDPOINT = "tcp/127.0.0.1:7448"
"""Where a router of ROS is looked for. rmw_zenoh's own default, port 7447, is the HLI's in the shipped cells."""

NODE = "deltaq"
CLIENT = "deltaq ros2"
_RETRY_S = 1.0
_SILENCE_S = 1.0
"""Time after which a waiting trajectory ends if no state arrives, so that none begins unexpectedly."""


@dataclass(frozen=True)
class RosSide:
    """The bridge's place in ROS.

    Attributes:
        endpoint: of the router.
        domain_id: of ROS.
        namespace: of node and topics; None: the cell's name.
        accepts: robots that trajectories may move.

    Raises:
        DeltaqError: a domain or a namespace that ROS does not allow.
        InvalidEndpointError: `endpoint` is no address.
    """

    endpoint: str = DEFAULT_ROS_ENDPOINT
    domain_id: int = 0
    namespace: str | None = None
    accepts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        Endpoint.parse(self.endpoint)
        checked_domain_id(self.domain_id)
        if self.namespace is not None:
            checked_namespace(self.namespace)


class Bridge:
    """Publishes the joint states of every robot of a cell, and executes trajectories for the permitted robots.

    Args:
        hli: address of the cell's HLI, e.g. `tcp/127.0.0.1:7447`.
        ros: the other side.

    Raises:
        DeltaqError: both sides have one address.
    """

    def __init__(self, hli: str, ros: RosSide) -> None:
        self._hli, self._ros = hli, ros
        here, there = Endpoint.parse(hli), Endpoint.parse(ros.endpoint)
        if here.port == there.port and (here.host == there.host or (here.is_loopback and there.is_loopback)):
            raise DeltaqError(
                f"--ros-endpoint {ros.endpoint}: the cell's HLI listens there ({hli}), which is no router of ROS; let "
                f"the router listen on another port, e.g. that of {DEFAULT_ROS_ENDPOINT}"
            )
        self._published: Counter[str] = Counter()
        self._counters: dict[str, Counter[str]] = {robot: Counter() for robot in ros.accepts}

    def summary(self) -> dict[str, Any]:
        """The bridge's counters so far, by robot."""
        robots = {
            robot: {"joint_states": count, "trajectories": dict(self._counters.get(robot, {}))}
            for robot, count in self._published.items()
        }
        return {"ros_endpoint": self._ros.endpoint, "domain_id": self._ros.domain_id, "robots": robots}

    async def run(self) -> None:
        """Serve until cancelled; once it has begun, cell and router may come and go.

        Raises:
            ServiceUnreachableError: one of them is not there at the beginning.
            DeltaqError: the cell has no such robot, or two robots have one name in ROS.
        """
        has_begun = asyncio.Event()
        while True:
            why = await self._until_gone(has_begun)
            if not has_begun.is_set():
                raise why
            _log.warning("%s; trying again", why)
            await asyncio.sleep(_RETRY_S)

    async def _until_gone(self, has_begun: asyncio.Event) -> ServiceUnreachableError:
        """Serve until one side disconnects; returns which."""
        gone: list[BaseException] = []
        try:
            await self._serve(has_begun)
        except* ServiceUnreachableError as group:
            gone += group.exceptions
        why = gone[0]
        assert isinstance(why, ServiceUnreachableError)  # `_serve` ends in no other way
        return why

    async def _serve(self, has_begun: asyncio.Event) -> None:
        async with connect(self._hli, CLIENT) as cell:
            namespace = self._namespace(cell)
            ros = await RosSession.join(self._ros.endpoint, self._ros.domain_id, namespace, NODE)
            try:
                async with asyncio.TaskGroup() as tasks:
                    for robot in cell.robots:
                        topic = f"{namespace.rstrip('/')}/{ros_name(robot)}"
                        publisher = ros.publisher(f"{topic}/joint_states", JOINT_STATE)
                        tasks.create_task(self._publish(cell, robot, publisher))
                        if robot in self._ros.accepts:
                            move = self._obey(cell, robot, ros, f"{topic}/joint_trajectory")
                            tasks.create_task(move)
                    moved = ", ".join(self._ros.accepts) or "none"
                    _log.info(
                        "ready: joint states of %s under %s in ROS domain %d at %s; trajectories move %s",
                        ", ".join(cell.robots), namespace, self._ros.domain_id, self._ros.endpoint, moved,
                    )  # fmt: skip
                    has_begun.set()
            finally:
                await ros.leave()

    def _namespace(self, cell: Cell) -> str:
        """Of node and topics, after a check that the robots can be told apart there."""
        for robot in self._ros.accepts:
            if robot not in cell.robots:
                has = ", ".join(cell.robots)
                raise DeltaqError(f"no robot {robot!r} in cell {cell.description.cell}; it has {has}")
        names = [ros_name(robot) for robot in cell.robots]
        if len(set(names)) < len(names):
            raise DeltaqError(f"robots {', '.join(cell.robots)}: two of them get the same name in ROS")
        return self._ros.namespace or f"/{ros_name(cell.description.cell)}"

    async def _publish(self, cell: Cell, robot: str, publisher: RosPublisher) -> None:
        joint_states = JointStates(cell.robots[robot], cell.description.cycle_s)
        async for state in cell.states(robot):
            publisher.publish(joint_states.message(state, time.time_ns()))
            self._published[robot] += 1

    async def _obey(self, cell: Cell, robot: str, ros: RosSession, topic: str) -> None:
        """Drive the robot along the trajectories that come; between them its lease is free."""
        counters = self._counters[robot]
        mover = TrajectoryMover(robot, cell.robots[robot], cell.description.cycle_s, _say, counters)
        has_come = asyncio.Event()

        def take(message: bytes, attachment: bytes | None) -> None:
            mover.hear(message, attachment, time.time_ns())
            has_come.set()

        ros.subscribe(topic, JOINT_TRAJECTORY, take)
        while True:
            await has_come.wait()
            has_come.clear()
            try:
                while mover.has_work:
                    await self._drive(cell, robot, mover)
            except RefusedError as error:
                mover.lose(str(error))
            except ServiceUnreachableError as error:
                mover.lose(str(error))
                raise

    async def _drive(self, cell: Cell, robot: str, mover: TrajectoryMover) -> None:
        loop = asyncio.get_running_loop()
        try:
            async with await lease(cell, robot) as leased, asyncio.timeout(_SILENCE_S) as patience:
                answers = Answers(cell, leased)
                async for state in leased.states():
                    patience.reschedule(loop.time() + _SILENCE_S)
                    for cycle in await answers.due(state):
                        await answers.send(state, cycle, mover.increment(state, answers.view(state)))
                    for verdict in answers.verdicts():
                        mover.judged(verdict)
                    if not mover.has_work:
                        return
        except TimeoutError:
            mover.lose(f"no state of {robot} for {_SILENCE_S:g} s")


def _say(text: str, fields: Mapping[str, Any]) -> None:
    refused = fields.get("event") == "refused"
    _log.log(logging.WARNING if refused else logging.INFO, "%s", text, extra={"fields": dict(fields)})
