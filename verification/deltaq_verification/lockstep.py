"""The whole stack in one process and in virtual time: the very cores of the services, stepped in turn.

Emulated KRC, Robot Server, SIM and HLI exchange the messages and telegrams that they exchange over UDP and
zenoh, one cycle of all robots after the other. Nothing waits, so it runs faster than real time, and nothing is
random, so the same controllers give the same run to the bit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import RsiDescription
from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.robot import RobotModel
from deltaq_emulator.krc import Krc
from deltaq_emulator.profiles import profile_for
from deltaq_emulator.settings import KrcSettings
from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, Command, CommandReply, Request, ServerState, Supervision
from deltaq_protocol.messages import (
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    ResetRequest,
    RobotState,
    ToolPose,
    Verdict,
)
from deltaq_protocol.rsi import AxisMap, SensorCodec, load_ethernet_xml
from deltaq_services.hli.core import HliCore
from deltaq_services.hli.outputs import Output as HliOutput
from deltaq_services.hli.outputs import Sender, ToGuarded, ToOpen, ToSender
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.sim.answers import Output as SimOutput
from deltaq_services.sim.core import Sim
from deltaq_verification.wire import PerfectWire, Wire

T = TypeVar("T")


class LockstepError(Exception):
    """A request that a client of the lockstep run depends on was refused."""


class _Client(Sender):
    """A controller's end of the HLI: keeps the messages that it got."""

    lasting = True

    def __init__(self) -> None:
        self.received: list[Message] = []

    def deliver(self, message: Message) -> None:
        self.received.append(message)

    def take(self, kind: type[Message]) -> Message | None:
        """The newest message of a kind since the last call."""
        found = [message for message in self.received if isinstance(message, kind)]
        self.received.clear()
        return found[-1] if found else None


@dataclass
class Arm:
    """One robot: its emulated controller, its Robot Server, and the links between it and the gate.

    Attributes:
        krc: the emulated controller; None for a kinematic robot.
        server: the Robot Server's core.
        state: what controllers see; None before the first cycle.
        admissions, supervisions, states: links from and to the gate; perfect unless replaced.
    """

    krc: Krc | None
    rsi: RsiDriver | None
    server: RobotServer
    q: Array
    client: _Client = field(default_factory=_Client)
    token: str | None = None
    seq: int = 0
    state: RobotState | None = None
    admissions: Wire[Admission] = field(default_factory=PerfectWire)
    supervisions: Wire[Supervision] = field(default_factory=PerfectWire)
    states: Wire[ServerState] = field(default_factory=PerfectWire)

    def cycle(self, time_s: float) -> ServerState | None:
        """One telegram and its answer, with the newest message of the gate, as a ring channel keeps it."""
        admission = _last(self.admissions.arrived())
        supervision = _last(self.supervisions.arrived())
        if self.krc is None or self.rsi is None:
            start = self.q if self.server.state is None else None
            measured: Measurement | None = Measurement(round(time_s * 1000), self.q, start)
        else:
            telegram = self.krc.tick()
            if telegram is None:
                self.server.krc_silent(time_s)
                return self.server.state
            measured = self.rsi.read(telegram, time_s)
            self.q = self.krc.sample.q
        if measured is None:
            if self.krc is not None and self.rsi is not None and self.rsi.unmoved is not None:
                self.krc.receive(self.rsi.unmoved)
            return None
        q_cmd = self.server.cycle(measured, time_s, admission, supervision)
        if self.krc is not None and self.rsi is not None:
            self.krc.receive(self.rsi.reply(q_cmd, self.server.outputs, self.server.motion_stop))
            if self.rsi.fault is not None:
                self.server.reply_refused(self.rsi.q_sent)
        else:
            self.q = q_cmd
        return self.server.state


class Lockstep:
    """A cell in virtual time.

    Args:
        cell_name: name or file of the cell.
        start: (n,) configuration of each robot that does not start at home [rad or m].

    Attributes:
        cell: its model.
        arms: its robots.
        cycle_count: cycles so far.
    """

    def __init__(self, cell_name: str | Path, start: Mapping[str, Array] | None = None) -> None:
        self.cell = CellModel.load(cell_name)
        self.cycle_count = 0
        self.sim = Sim(self.cell, epoch=1)
        told = self.cell.description_message()
        self.hli = HliCore(self.cell.description, told, self._tool_pose, self._new_token, first_epoch=1)
        self._tokens = 0
        self.arms = {
            name: _arm(self.cell, name, robot, find_cell(cell_name), (start or {}).get(name, robot.home))
            for name, robot in self.cell.robots.items()
        }

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self.cycle_count * self.cell.description.cycle_s

    def cycle(self, robots: Collection[str] | None = None) -> None:
        """One cycle of every robot, or of some whose clocks are ahead; afterwards controllers may ask."""
        self.cycle_count += 1
        for name, arm in self.arms.items():
            if robots is not None and name not in robots:
                continue
            state = arm.cycle(self.time_s)
            if state is not None:
                arm.states.send(state)
                self._from_hli(self.hli.on_server_state(state, self.time_s))
            for arrived in arm.states.arrived():
                self._from_sim(self.sim.on_state(arrived))

    def run_until_ready(self) -> None:
        """Cycle until every robot has been heard by the gate and the gate by every robot."""
        for _ in range(100):
            self.cycle()
            if all(arm.state is not None and arm.state.phase == "ready" for arm in self.arms.values()):
                return
        phases = {name: arm.state and arm.state.phase for name, arm in self.arms.items()}
        raise LockstepError(f"the robots are not ready after 100 cycles: {phases}")

    def acquire(self, robot: str, client: str) -> None:
        """Take the lease of a robot for `client`."""
        arm = self.arms[robot]
        request = LeaseRequest(robot=robot, action=LeaseAction.ACQUIRE, client=client)
        self._from_hli(self.hli.requests.on_lease(request, arm.client, self.time_s))
        reply = arm.client.take(LeaseReply)
        if not isinstance(reply, LeaseReply) or not reply.granted:
            raise LockstepError(f"no lease of {robot} for {client}: {reply}")
        arm.token = reply.lease

    def ask(self, robot: str, dq: Array) -> Verdict | None:
        """Answer the robot's newest state with an increment (n,) [rad or m]; returns the verdict."""
        arm = self.arms[robot]
        assert arm.state is not None  # run_until_ready comes first
        arm.seq += 1
        increment = Increment(
            robot=robot, seq=arm.seq, cycle=arm.state.cycle, dq=tuple(dq.tolist()), lease=arm.token
        )
        self._from_hli(self.hli.increments.on_increment(increment, arm.client, self.time_s))
        verdict = arm.client.take(Verdict)
        return verdict if isinstance(verdict, Verdict) else None

    def stop(self) -> None:
        """Press stop."""
        self._from_hli(self.hli.requests.on_stop(_Client(), self.time_s))

    def reset(self, robot: str) -> None:
        """Ask for a reset."""
        self._from_hli(self.hli.requests.on_reset(ResetRequest(robot=robot), _Client(), self.time_s))

    def _from_hli(self, outputs: list[HliOutput]) -> None:
        for output in outputs:
            if isinstance(output, ToSender):
                output.sender.deliver(output.message)
            elif isinstance(output, ToOpen):
                if isinstance(output.message, RobotState):
                    self.arms[output.robot].state = output.message
            elif isinstance(output, ToGuarded):
                if isinstance(output.message, Request):
                    self._from_sim(self.sim.on_request(output.message))
                elif isinstance(output.message, Command):
                    self._from_sim(self.sim.on_command(output.message))

    def _from_sim(self, outputs: list[SimOutput]) -> None:
        for output in outputs:
            message = output.message
            if isinstance(message, Admission):
                self.arms[output.robot].admissions.send(message)
            elif isinstance(message, Supervision):
                self.arms[output.robot].supervisions.send(message)
            elif isinstance(message, Verdict) and output.topic is topics.GATE_VERDICT:
                self._from_hli(self.hli.on_gate_verdict(message))
            elif isinstance(message, CommandReply):
                self._from_hli(self.hli.on_command_reply(message))

    def _tool_pose(self, robot: str, q: tuple[float, ...]) -> ToolPose:
        return self.cell.robots[robot].tool_pose(q)

    def _new_token(self) -> str:
        self._tokens += 1
        return f"token-{self._tokens}"


def _last(messages: list[T]) -> T | None:
    return messages[-1] if messages else None


def _arm(cell: CellModel, name: str, robot: RobotModel, cell_file: Path, q_start: Array) -> Arm:
    description, cycle_s = robot.description, cell.description.cycle_s
    server = RobotServer(cell.description, name, process=1)
    if not isinstance(description.driver, RsiDescription):
        return Arm(None, None, server, q_start)
    config = load_ethernet_xml(resolve_near(cell_file, description.driver.ethernet_xml))
    axes = AxisMap.of(description.joint_names, description.units, description.driver.krc)
    T_base_world = np.linalg.inv(robot.T_world_base)
    krc = Krc(
        description,
        cycle_s,
        config,
        profile_for(description.driver.krc, cycle_s),
        q_start,
        lambda q: T_base_world @ robot.forward(q),
        KrcSettings.load(),
    )
    driver = description.driver
    codec = SensorCodec(config, axes, driver.inputs, driver.outputs, driver.stop)
    return Arm(krc, RsiDriver(codec, cell.description, name, server.counters), server, q_start)
