"""A peer of rmw_zenoh's, written from its design document: a router, and what a ROS program says and hears there.

Keys and tokens are spelled out: it shares nothing with the bridge but the library of messages.
"""

import json
import queue
import struct
from typing import Any

import zenoh
from ros_types import JOINT_STATE, STORE, Floats, encoded, point, trajectory

STATE_TYPE = (
    "sensor_msgs::msg::dds_::JointState_/"
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
)
COMMAND_TYPE = (
    "trajectory_msgs::msg::dds_::JointTrajectory_/"
    "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
)
_WAITS_S = 300.0
GID = bytes(range(16))


class RosPeer:
    """A router as rmw_zenohd is one, with a program in the same session.

    Args:
        endpoint: to listen on.
        domain_id: of ROS.

    Attributes:
        endpoint: as given.
        tokens: of entities that came (True) or went.
    """

    def __init__(self, endpoint: str, domain_id: int = 0) -> None:
        config = zenoh.Config()
        for key, value in {
            "mode": "router",
            "listen/endpoints": [endpoint],
            "scouting/multicast/enabled": False,
            "routing/router/peers_failover_brokering": False,
        }.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.endpoint = endpoint
        self._domain_id = domain_id
        self._sent = 0
        self.tokens: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._watch = self.session.liveliness().declare_subscriber(
            f"@ros2_lv/{domain_id}/**",
            lambda sample: self.tokens.put((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)),
            history=True,
        )

    def token(self) -> tuple[str, bool]:
        """The next entity that came (True) or went."""
        return self.tokens.get(timeout=_WAITS_S)

    def subscribe(self, topic: str) -> queue.SimpleQueue[tuple[Any, tuple[int, int, bytes]]]:
        """Joint states of a topic, each with its attachment: sequence number, time [ns] and gid."""
        heard: queue.SimpleQueue[tuple[Any, tuple[int, int, bytes]]] = queue.SimpleQueue()

        def hear(sample: zenoh.Sample) -> None:
            sequence, time_ns, size, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
            assert size == 16
            heard.put(
                (STORE.deserialize_cdr(sample.payload.to_bytes(), JOINT_STATE), (sequence, time_ns, gid))
            )

        self.session.declare_subscriber(f"{self._domain_id}{topic}/{STATE_TYPE}", hear)
        return heard

    def command(self, topic: str, joints: tuple[str, ...], *points: tuple[float, Floats]) -> None:
        """Publish a trajectory of positions [rad or m] at times [s]."""
        self.say(topic, encoded(trajectory(joints, *(point(*one) for one in points))))

    def say(self, topic: str, message: bytes) -> None:
        """Publish bytes as a trajectory."""
        self._sent += 1
        attachment = struct.pack("<qqB16s", self._sent, 0, 16, GID)
        self.session.put(f"{self._domain_id}{topic}/{COMMAND_TYPE}", message, attachment=attachment)

    def close(self) -> None:
        """End the router."""
        self._watch.undeclare()
        self.session.close()
