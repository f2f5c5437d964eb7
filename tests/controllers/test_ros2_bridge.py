"""The bridge between a real HLI and a peer that speaks as rmw_zenoh's design document says, over zenoh on loopback.

The cell behind the HLI admits whatever it is asked; the real gate is in `test_ros2_mover.py`.
"""

import asyncio
import json
import logging
import os
import queue
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from ran import ran
from ros_types import JOINT_STATE, STORE, Floats, encoded, point, trajectory
from served import Server
from small_cell import endpoint

from deltaq_controllers.ros2.bridge import Bridge, RosSide
from deltaq_protocol.blocking import connect
from deltaq_protocol.endpoint import InvalidEndpointError
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError

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


DELTAQ = str(Path(sys.executable).with_name("deltaq"))
JOINTS = ("a1", "a2", "a3", "a4", "a5", "a6")
STATES, COMMANDS = "/small/fr/joint_states", "/small/fr/joint_trajectory"
WAITS_S = 300.0
DOMAIN = 7


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with Server(gate={"lookahead_cycles": 3}) as running:
        yield running


@pytest.fixture
def peer() -> Iterator[RosPeer]:
    one = RosPeer(endpoint(), DOMAIN)
    yield one
    one.close()


class Running:
    """A bridge in a thread of its own, and what it logs."""

    def __init__(self, bridge: Bridge, said: queue.SimpleQueue[str]) -> None:
        self.bridge, self._said = bridge, said

    def until(self, text: str) -> str:
        """The next line with a text in it."""
        while text not in (line := self._said.get(timeout=WAITS_S)):
            pass
        return line


class _Lines(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.put(record.getMessage())


@contextmanager
def bridged(hli: str, ros: RosSide) -> Iterator[Running]:
    log, handler = logging.getLogger("deltaq_controllers.ros2.bridge"), _Lines()
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    bridge, loop = Bridge(hli, ros), asyncio.new_event_loop()
    task = loop.create_task(bridge.run())
    thread = threading.Thread(target=_run, args=(loop, task))
    thread.start()
    try:
        running = Running(bridge, handler.lines)
        running.until("ready: ")
        yield running
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join()
        loop.close()
        log.removeHandler(handler)
        log.setLevel(level)


def _run(loop: asyncio.AbstractEventLoop, task: asyncio.Task[None]) -> None:
    asyncio.set_event_loop(loop)
    loop.run_until_complete(asyncio.wait([task]))


def test_joint_states_reach_a_ros_program_and_the_bridge_is_in_the_graph(
    server: Server, peer: RosPeer
) -> None:
    heard = peer.subscribe(STATES)
    with bridged(server.description.hli, RosSide(peer.endpoint, DOMAIN)) as running:
        first, (sequence, sent_ns, gid) = heard.get(timeout=WAITS_S)
        second, (next_sequence, _, next_gid) = heard.get(timeout=WAITS_S)
        assert next_sequence == sequence + 1
        assert len(gid) == 16
        assert gid == next_gid
        assert abs(sent_ns - time.time_ns()) < WAITS_S * 1e9
        assert abs(first.header.stamp.sec - time.time()) < WAITS_S
        assert tuple(second.name) == JOINTS
        np.testing.assert_allclose(second.position, [0.1] * 6)
        np.testing.assert_allclose(second.velocity, [0.0] * 6)
        assert len(second.effort) == 0
        tokens = sorted(peer.token() for _ in range(3))
        zid = tokens[0][0].split("/")[2]
        begin = f"@ros2_lv/7/{zid}/0"
        kept = f"{STATE_TYPE}/::,10:,:,:,,"
        assert tokens == [
            (f"{begin}/0/NN/%/%small/deltaq", True),
            (f"{begin}/1/MP/%/%small/deltaq/%small%fr%joint_states/{kept}", True),
            (f"{begin}/2/MP/%/%small/deltaq/%small%gr%joint_states/{kept}", True),
        ]  # fmt: skip
        assert running.bridge.summary()["robots"]["fr"]["trajectories"] == {}
    assert sorted(peer.token() for _ in range(3)) == [(token, False) for token, _ in tokens]


@pytest.mark.long
def test_a_trajectory_moves_only_robots_with_accept_trajectories(server: Server, peer: RosPeer) -> None:
    heard = peer.subscribe(STATES)
    # so slow that a machine which stands still for a moment does not take the robot off its path
    command = (COMMANDS, JOINTS, (3.0, [0.15] * 6))
    with bridged(server.description.hli, RosSide(peer.endpoint, DOMAIN, accepts=("gr",))):
        peer.command(*command)
        for _ in range(20):
            state, _ = heard.get(timeout=WAITS_S)
        np.testing.assert_allclose(state.position, [0.1] * 6)
    with (
        bridged(server.description.hli, RosSide(peer.endpoint, DOMAIN, accepts=("fr",))) as running,
        connect(server.description.hli, "watcher") as cell,
    ):
        while "MS" not in peer.token()[0]:
            pass
        peer.command(*command)
        running.until("fr: a trajectory of 1 points and 3 s came")
        while cell.status().robots["fr"].lease.holder != "deltaq ros2":
            pass
        running.until("fr: the trajectory has ended: the robot has arrived")
        np.testing.assert_allclose(server.peer.q_cmd["fr"], [0.15] * 6, atol=1e-7)
        while cell.status().robots["fr"].lease.holder is not None:
            pass
        counters = running.bridge.summary()["robots"]["fr"]["trajectories"]
        assert counters == {"trajectories": 1, "ended_arrived": 1}


def test_refusals_are_logged_in_a_line_and_a_taken_lease_ends_a_trajectory(
    server: Server, peer: RosPeer
) -> None:
    hli = server.description.hli
    with bridged(hli, RosSide(peer.endpoint, DOMAIN, accepts=("fr",))) as running:
        while "MS" not in peer.token()[0]:
            pass
        peer.say(COMMANDS, b"\x00\x01\x00\x00\xff")
        assert "message is malformed (Could not deserialize" in running.until("refused")
        peer.command(COMMANDS, JOINTS[:5], (1.0, [0.1] * 5))
        assert "joint_names is without a6" in running.until("refused")
        with connect(hli, "other") as cell, cell.lease("fr"):
            peer.command(COMMANDS, JOINTS, (1.0, [0.2] * 6))
            assert "lease_taken: the lease of fr was not granted" in running.until("ended")
        peer.command(COMMANDS, JOINTS, (60.0, [0.2] * 6))
        running.until("a trajectory of 1 points and 60 s came")
        with connect(hli, "other") as cell:
            while cell.status().robots["fr"].lease.holder != "deltaq ros2":
                pass
            with cell.lease("fr", take=True):
                assert "lease_not_held: the lease of fr was lost: other holds it now" in running.until(
                    "ended"
                )
        counters = running.bridge.summary()["robots"]["fr"]["trajectories"]
        assert counters["refused"] == 2
        assert counters["ended_lost"] == 2


def test_a_trajectory_does_not_wait_for_a_robot_that_has_no_states(server: Server, peer: RosPeer) -> None:
    joints = tuple(server.description.robots["gr"].joints)
    with bridged(server.description.hli, RosSide(peer.endpoint, DOMAIN, accepts=("gr",))) as running:
        while "MS" not in peer.token()[0]:
            pass
        peer.command("/small/gr/joint_trajectory", joints, (1.0, [0.2] * 9))
        assert running.until("ended").endswith("gr: the trajectory has ended: no state of gr for 1 s")


def test_a_restarted_router_is_found_again(server: Server) -> None:
    listening = endpoint()
    first = RosPeer(listening, DOMAIN)
    try:
        with bridged(server.description.hli, RosSide(listening, DOMAIN)):
            first.subscribe(STATES).get(timeout=WAITS_S)
            first.close()
            first = RosPeer(listening, DOMAIN)
            first.subscribe(STATES).get(timeout=WAITS_S)
            assert sum("/MP/" in first.token()[0] for _ in range(3)) == 2
    finally:
        first.close()


@pytest.mark.nightly
def test_missing_peers_are_named_at_the_start(server: Server) -> None:
    nowhere, hli = endpoint(), server.description.hli
    with pytest.raises(ServiceUnreachableError, match=f"no zenoh router answers at {nowhere}"):
        asyncio.run(Bridge(hli, RosSide(nowhere)).run())
    with pytest.raises(ServiceUnreachableError, match=f"no server answers at {nowhere}"):
        asyncio.run(Bridge(nowhere, RosSide(hli)).run())


def test_impossible_options_are_reported_before_a_file_is_opened(server: Server, peer: RosPeer) -> None:
    hli = server.description.hli
    with pytest.raises(DeltaqError, match=f"--ros-endpoint {hli}: the cell's HLI listens there"):
        Bridge(hli, RosSide(hli))
    with pytest.raises(DeltaqError, match="the cell's HLI listens there"):
        Bridge("tcp/127.0.0.1:7447", RosSide("tcp/localhost:7447"))
    with pytest.raises(InvalidEndpointError):
        RosSide("localhost")
    with pytest.raises(DeltaqError, match="no ROS namespace"):
        RosSide(namespace="lab")
    with pytest.raises(DeltaqError, match="no robot 'rf' in cell small; it has fr, gr"):
        asyncio.run(Bridge(hli, RosSide(peer.endpoint, accepts=("rf",))).run())


@pytest.mark.service
def test_the_command_ends_with_its_counts_in_json(server: Server, peer: RosPeer) -> None:
    heard = peer.subscribe("/plant/fr/joint_states")
    arguments = (
        "--url",
        server.description.hli,
        "--ros-endpoint",
        peer.endpoint,
        "--namespace",
        "/plant",
        "--json",
    )
    process = subprocess.Popen(
        [DELTAQ, "ros2", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)},
    )
    heard.get(timeout=WAITS_S)
    process.send_signal(signal.SIGTERM)
    lines = process.communicate(timeout=WAITS_S)[0].splitlines()
    told: list[dict[str, Any]] = [json.loads(line) for line in lines]
    assert process.returncode == 0
    assert told[0]["message"].startswith("ready: joint states of fr, gr under /plant in ROS domain 7")
    assert told[-1]["fields"]["robots"]["fr"]["joint_states"] > 0


@pytest.mark.long
def test_wrong_use_of_the_command_gives_one_line(server: Server) -> None:
    wrong = {
        ("--domain-id", "233"): "less than or equal to 232",
        ("--namespace", "a b"): "no ROS namespace: 'a b'",
        ("--ros-endpoint", "x"): "'x' is no endpoint",
    }
    for arguments, text in wrong.items():
        done = ran([DELTAQ, "ros2", "--url", server.description.hli, *arguments], check=False)
        assert done.returncode == 2
        assert text in " ".join(done.stderr.replace("│", " ").split())
        assert "Traceback" not in done.stderr
