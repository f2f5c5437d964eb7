"""The guarded realm over real sockets, in lockstep: Robot Servers, the SIM's shell, and an HLI that asks.

Nothing here waits for a clock, so that a braked cycle has a cause other than a busy machine. Open it with the fixture
`lasting_links`: zenoh's links have a clock of their own, which closes them when the machine pauses.
"""

import contextlib
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.codec import pack
from deltaq_protocol.envelope import Envelopes, StaleMessageError
from deltaq_protocol.guarded import Admission, Command, Request, ServerState, Supervision
from deltaq_protocol.messages import Message
from deltaq_protocol.sayings import HLI, sayings
from deltaq_protocol.session import open_session, subscribe_newest
from deltaq_services.guarded_realm import guarded_links, service_tls
from deltaq_services.phases import MAY_MOVE
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.sim.shell import Shell
from deltaq_testing.private_cell import write_private_cell

RECORDED = 4096
_ARRIVES_S = 0.05
"""Longest wait for the states of a cycle while links come up [s]."""


class ServedRobot:
    """A Robot Server's core on its real link, and a robot that is always where it was sent."""

    def __init__(self, model: CellModel, name: str, process: int) -> None:
        self.name = name
        self.q = model.robots[name].home.copy()
        self.core = RobotServer(model.description, name, process)
        self.link = GuardedLink(model.description, name, self.core.counters)
        self.admission: Admission | None = None
        self.supervision: Supervision | None = None
        self._time_s = 0.0

    @property
    def state(self) -> ServerState:
        assert self.core.state is not None  # asked only after a cycle
        return self.core.state

    def listen(self) -> None:
        """Read what has come, as a cycle begins by doing."""
        for admission in self.link.admissions():
            self.admission = admission
        self.supervision = self.link.supervision() or self.supervision

    def cycle(self) -> None:
        """One telegram, answered by what has been read, and the state published."""
        self.listen()
        self._time_s += 0.012
        start = self.q if self.core.state is None else None
        measured = Measurement(round(self._time_s * 1000), self.q, start)
        self.q = self.core.cycle(measured, self._time_s, self.admission, self.supervision)
        self.admission = self.supervision = None
        self.link.publish(self.core.state, self._time_s)


class LockstepRealm:
    """Both robots of the lab cell, ready.

    Attributes:
        robots: by name.
        sim: the gate's core.
        recording: every sample of the realm so far, as anybody who joins can record it: key and bytes.
    """

    def __init__(self, folder: Path, encrypted_at: str | None = None) -> None:
        self.model = CellModel.load(write_private_cell(folder, encrypted_at=encrypted_at))
        description = self.description = self.model.description
        self._process = 0
        self.robots = {name: self._robot(name) for name in description.robots}
        self.shell = Shell(self.model)
        self.sim = self.shell.sim
        robots = tuple(description.robots)
        self.envelopes = Envelopes(HLI, description.cell, robots)
        table = sayings(description.cell, robots)
        self._said_to_hli = {row.key for row in table if HLI in row.listeners}
        links = list(guarded_links(description).values())
        tls = service_tls(description, links, os.environ.get(IDENTITY), HLI)
        self._hli = open_session(connect=links, must_connect=True, tls=tls)
        self._heard = subscribe_newest(self._hli, f"deltaq-guarded/{description.cell}/**", RECORDED)
        self.recording: list[tuple[str, bytes]] = []
        self._seq = 0
        self._id = 0
        self.settle()

    def close(self) -> None:
        self._hli.close()
        self.shell._session.close()
        for robot in self.robots.values():
            robot.link.close()

    def settle(self) -> None:
        """Cycle until the gate follows both robots and both may move.

        Each cycle gives its states time to arrive: a link takes a fifth of a second to come up, and the gate does not
        believe a robot that may move and was not heard for as many cycles as would pass meanwhile.

        Who may move already gets the gate's word in each cycle: were it left to the links' threads to be in time, a
        robot would stop for a gate that it did not hear.
        """
        while not all(self.ready(robot) for robot in self.robots.values()):
            self.turn()
            moving = [robot for robot in self.robots.values() if robot.state.phase in MAY_MOVE]
            self.pump_until(lambda moving=moving: all(self.has_mail(robot) for robot in moving))
            end_s = time.monotonic() + _ARRIVES_S
            self.pump_until(lambda end_s=end_s: self.gate_sees_all() or time.monotonic() > end_s)

    def gate_sees_all(self) -> bool:
        return all(self.sees(robot) for robot in self.robots.values())

    def ready(self, robot: ServedRobot) -> bool:
        state = self.sim.robots[robot.name].tracker.state
        known = state is not None and state.process == robot.core.process and state.epoch == self.sim.epoch
        return known and robot.state.phase in MAY_MOVE

    def turn(self) -> None:
        """A cycle of each robot, and whatever comes of it by now; the HLI gives its heartbeat."""
        for robot in self.robots.values():
            robot.cycle()
            self.put(topics.REQUEST, self._request(robot), robot=robot.name)
        self.pump()

    def cycle(self, moving: dict[str, float], attack: Any = None) -> None:
        """One cycle in which the gate hears every state and request, and every robot hears the gate.

        Args:
            moving: by robot the increment of its first joint [rad or m]; the others only give a heartbeat.
            attack: called while the messages of the cycle are on their way.
        """
        for robot in self.robots.values():
            robot.cycle()
        self.pump_until(self.gate_sees_all)
        if attack is not None:
            attack()
        for robot in self.robots.values():
            dq = moving.get(robot.name)
            request = self._request(robot)
            if dq is not None:
                self._seq += 1
                joints = (dq, *np.zeros(len(robot.q) - 1).tolist())
                request = request.model_copy(update={"seq": self._seq, "dq": joints})
            self.put(topics.REQUEST, request, robot=robot.name)
        wanted = [self.robots[name] for name in moving]
        self.pump_until(lambda: all(self.is_admitted(robot) for robot in wanted))
        self.pump_until(lambda: all(self.has_mail(robot) for robot in self.robots.values()))

    def assert_moves(self, cycles: int, step: float) -> None:
        """Both robots' first joints travel `step` [rad or m] in each of so many cycles, and nothing is refused."""
        start = {name: robot.q.copy() for name, robot in self.robots.items()}
        for _ in range(cycles):
            self.cycle(dict.fromkeys(self.robots, step))
        for name, robot in self.robots.items():
            robot.cycle()
            assert abs(robot.q[0] - start[name][0] - cycles * step) < 1e-9
            assert robot.core.counters["admissions"] == cycles
            assert robot.core.counters["braked_cycles"] == 0

    def sees(self, robot: ServedRobot) -> bool:
        """Whether the gate has the newest state of a robot."""
        state = self.sim.robots[robot.name].tracker.state
        return state is not None and state.cycle == robot.state.cycle

    def is_admitted(self, robot: ServedRobot) -> bool:
        in_flight = self.sim.robots[robot.name].tracker.in_flight
        return any(admission.cycle == robot.state.cycle for admission in in_flight)

    def has_mail(self, robot: ServedRobot) -> bool:
        """Whether all that the gate said on the newest state has come."""
        robot.listen()
        is_spared = self.shell._spared._spared[robot.name] > 0  # the newest
        if not is_spared and (robot.supervision is None or robot.supervision.cycle != robot.state.cycle):
            return False
        return robot.admission is not None or not self.is_admitted(robot)

    def restart(self, name: str) -> ServedRobot:
        """Another process takes the place of a robot's server; nobody has spoken to it yet."""
        robot = self.robots[name]
        robot.link.close()
        self.robots[name] = self._robot(name)
        self.robots[name].q = robot.q
        return self.robots[name]

    def restart_gate(self) -> None:
        """Another process takes the gate's place; it has heard nobody yet."""
        self.shell._session.close()
        self.shell = Shell(self.model)
        self.sim = self.shell.sim

    def settle_held(self) -> None:
        """Cycle until the gate has heard every robot."""
        while not self.gate_sees_all():
            self.turn()

    def command(self, **fields: Any) -> None:
        """The HLI sends a command."""
        self._id += 1
        cycles = {name: robot.state.cycle for name, robot in self.robots.items()}
        self.put(topics.COMMAND, Command(id=self._id, epoch=self.sim.epoch, cycles=cycles, **fields))

    def put(self, topic: topics.Topic, message: Message, **fields: str) -> None:
        """Publish as the HLI, never dropped where the link is blocked: what comes of it is awaited."""
        key = topic.key(self.description.cell, **fields)
        block = zenoh.CongestionControl.BLOCK
        self._hli.put(key, self.envelopes.close(key, pack(message)), congestion_control=block)

    def pump(self) -> None:
        """Let the gate, the HLI and the Robot Servers take what has come."""
        for robot in self.robots.values():
            robot.listen()
        while (sample := self.shell._incoming.try_recv()) is not None:
            self.shell._handle(str(sample.key_expr), sample.payload.to_bytes())
        while (sample := self._heard.try_recv()) is not None:
            key, enclosed = str(sample.key_expr), sample.payload.to_bytes()
            self.recording.append((key, enclosed))
            if key in self._said_to_hli:
                with contextlib.suppress(StaleMessageError):
                    self.envelopes.open(key, enclosed)

    def pump_until(self, reached: Any) -> None:
        while not reached():
            self.pump()

    def _request(self, robot: ServedRobot) -> Request:
        return Request(robot=robot.name, cycle=robot.state.cycle, lease_epoch=1)

    def _robot(self, name: str) -> ServedRobot:
        self._process += 1
        return ServedRobot(self.model, name, self._process)
