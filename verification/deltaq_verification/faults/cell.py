"""A cell in virtual time whose processes can die, freeze and come back, and whose wires can be impaired.

The cores are those of the services and the emulator; routing and time are here. Within a cycle whatever is under
way arrives in the order of its time, so that a reply may be late by a fraction of a cycle, as it may over UDP.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from functools import partial

from deltaq_protocol import topics
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.guarded import Admission, Command, CommandReply, Request, ServerState, Supervision
from deltaq_protocol.messages import (
    Increment,
    LeaseRequest,
    Message,
    ResetRequest,
    RobotState,
    RobotStatus,
    StopRequest,
    Verdict,
)
from deltaq_services.hli.core import HliCore
from deltaq_services.hli.outputs import Output, Sender, ToGuarded, ToOpen
from deltaq_services.sim.answers import Output as SimOutput
from deltaq_services.sim.core import Sim
from deltaq_verification.faults.actions import Link, Process
from deltaq_verification.faults.arm import Life, VirtualArm
from deltaq_verification.faults.cell_factory import CellFactory
from deltaq_verification.faults.controller import VirtualController
from deltaq_verification.faults.wires import MessageWire, next_arrival_s

_RING = 64
"""Messages that wait for a process that stands still, as the SIM's ring channel keeps them."""

_BEGAN_S = 1e9
"""Time of day at the beginning: epochs and ids are counted from it [s since 1970]."""

_ENDS = {
    Link.CONTROLLER_HLI: (Process.CONTROLLER, Process.HLI),
    Link.HLI_SIM: (Process.HLI, Process.SIM),
    Link.HLI_SERVER: (Process.ROBOT_SERVER, Process.HLI),
    Link.SIM_SERVER: (Process.SIM, Process.ROBOT_SERVER),
}


class Port(Sender):
    """A client's end of the HLI: keeps what it was told."""

    lasting = True

    def __init__(self) -> None:
        self.received: list[Message] = []

    def deliver(self, message: Message) -> None:
        """Take an answer."""
        self.received.append(message)


class VirtualCell:
    """The cell; faults befall one robot, its controller, and what they share with the others.

    Args:
        loaded: the cell.
        robot: the one that moves.
        seed: of the wires' random numbers.

    Attributes:
        cell: its model.
        arms: its robots.
        wires: by link and the process at the receiving end.
        clock_s: what the HLI's clock is ahead.
        wall_clock_s: what the time of day is ahead that a new HLI finds.
    """

    def __init__(self, loaded: CellFactory, robot: str, seed: int = 0) -> None:
        self.cell, self.robot = loaded.model, robot
        self._loaded = loaded
        self.now_s, self.cycle_count = 0.0, 0
        self.clock_s = self.wall_clock_s = 0.0
        self._begun, self._tokens = 0, 0
        self._sim, self._hli = self._new_sim(), self._new_hli()
        self._lives = dict.fromkeys((Process.CONTROLLER, Process.HLI, Process.SIM), Life.RUNNING)
        self._backlogs: dict[Process, deque[Message]] = {p: deque(maxlen=_RING) for p in self._lives}
        self.wires = {
            (link, to): MessageWire(partial(self._arrive, to), seed + 10 * number)
            for number, (link, to) in enumerate((link, to) for link, ends in _ENDS.items() for to in ends)
        }
        timeout_s = self.cell.description.gate.krc_timeout_s
        self.arms = {
            name: VirtualArm(
                name, loaded.krc(name), partial(loaded.server, name), self._publish, timeout_s, seed + 100
            )
            for name in self.cell.robots
        }
        self._links = [wire.link for wire in self.wires.values()]
        self._links += [link for arm in self.arms.values() for link in (arm.to_pc, arm.from_pc)]
        self.port, self.controller = Port(), self._new_controller()
        self._operator = Port()

    # --- time ---------------------------------------------------------------------------------------------

    def cycle(self) -> None:
        """One cycle of every robot's KRC, and all that arrives in it."""
        cycle_s = self.cell.description.cycle_s
        self.now_s = self.cycle_count * cycle_s
        self.cycle_count += 1
        end_s = self.cycle_count * cycle_s
        if self._lives[Process.HLI] is Life.RUNNING:
            self._from_hli(self._hli.on_tick(self._hli_s))
        for arm in self.arms.values():
            arm.begin_cycle(self.now_s)
        # what is due exactly at the end belongs to the next cycle, up to rounding
        while (due_s := next_arrival_s(self._links)) is not None and due_s < end_s - 1e-9:
            self.now_s = max(self.now_s, due_s)
            for arm in self.arms.values():
                arm.pump(self.now_s)
            for wire in self.wires.values():
                wire.pump(self.now_s)
        for arm in self.arms.values():
            arm.end_cycle(end_s)

    @property
    def _hli_s(self) -> float:
        return self.now_s + self.clock_s

    # --- processes ----------------------------------------------------------------------------------------

    def kill(self, process: Process) -> None:
        """End a process at once; the HLI sees a controller's connection close."""
        if process is Process.ROBOT_SERVER:
            self.arms[self.robot].life = Life.DEAD
            return
        self._lives[process] = Life.DEAD
        self._backlogs[process].clear()
        if process is Process.CONTROLLER and self.controller.token is not None:
            leases = [(self.robot, self.controller.token)]
            self._from_hli(self._hli.requests.on_connection_lost(leases, self._hli_s))

    def freeze(self, process: Process) -> None:
        """Let a process stand still; what comes waits."""
        if process is Process.ROBOT_SERVER:
            self.arms[self.robot].life = Life.FROZEN
        else:
            self._lives[process] = Life.FROZEN

    def thaw(self, process: Process) -> None:
        """Let a process go on."""
        if process is Process.ROBOT_SERVER:
            self.arms[self.robot].thaw(self.now_s)
            return
        self._lives[process] = Life.RUNNING
        backlog = self._backlogs[process]
        while backlog:
            self._arrive(process, backlog.popleft())

    def restart(self, process: Process) -> None:
        """Start a process anew."""
        match process:
            case Process.ROBOT_SERVER:
                self.arms[self.robot].restart(self.now_s)
                return
            case Process.CONTROLLER:
                self.port, self.controller = Port(), self._new_controller()
            case Process.HLI:
                self._hli = self._new_hli()
                self.controller.token = None  # its connection broke
            case Process.SIM:
                self._sim = self._new_sim()
        self._lives[process] = Life.RUNNING

    def links_from(self, process: Process) -> list[MessageWire]:
        """The wires on which a process speaks."""
        return [
            wire for (link, to), wire in self.wires.items() if process in _ENDS[link] and to is not process
        ]

    def links_of(self, link: Link) -> list[MessageWire]:
        """Both directions of a link."""
        return [wire for (at, _), wire in self.wires.items() if at is link]

    # --- the operator -------------------------------------------------------------------------------------

    def stop(self) -> None:
        """Press stop."""
        self._arrive(Process.HLI, StopRequest())

    def reset(self) -> Port:
        """Ask for a reset of the robot; where the answer comes."""
        self._operator = Port()
        self._arrive(Process.HLI, ResetRequest(robot=self.robot))
        return self._operator

    def status(self) -> RobotStatus:
        """The robot as the HLI shows it."""
        return self._hli.status(self._hli_s, Counter()).robots[self.robot]

    # --- routing ------------------------------------------------------------------------------------------

    def _publish(self, state: ServerState) -> None:
        self._send(Link.SIM_SERVER, Process.SIM, state)
        self._send(Link.HLI_SERVER, Process.HLI, state)

    def _send(self, link: Link, to: Process, message: Message) -> None:
        if getattr(message, "robot", None) in (None, self.robot):
            self.wires[link, to].send(self.now_s, message)
        else:
            self._arrive(to, message)  # the other robot's wires are well

    def _arrive(self, process: Process, message: Message) -> None:
        if process is Process.ROBOT_SERVER:
            assert isinstance(message, Admission | Supervision)  # nothing else is sent there
            self.arms[message.robot].take(message)
        elif self._lives[process] is Life.FROZEN:
            self._backlogs[process].append(message)
        elif self._lives[process] is Life.RUNNING:
            match process:
                case Process.SIM:
                    self._from_sim(self._sim.take(message))
                case Process.HLI:
                    self._from_hli(self._ask_hli(message))
                case Process.CONTROLLER:
                    self.controller.take(message)

    def _ask_hli(self, message: Message) -> list[Output]:
        hli, now_s = self._hli, self._hli_s
        match message:
            case ServerState():
                return hli.on_server_state(message, now_s)
            case Verdict():
                return hli.on_gate_verdict(message)
            case CommandReply():
                return hli.on_command_reply(message)
            case Increment():
                return hli.increments.on_increment(message, self.port, now_s)
            case LeaseRequest():
                return hli.requests.on_lease(message, self.port, now_s)
            case StopRequest():
                return hli.requests.on_stop(Port(), now_s)
            case ResetRequest():
                return hli.requests.on_reset(message, self._operator, now_s)
        raise TypeError(f"the HLI is sent no {type(message).__name__}")

    def _bad_increment(self, error: InvalidMessageError) -> None:
        if self._lives[Process.HLI] is Life.RUNNING:
            self._from_hli(self._hli.increments.on_bad_increment(error, self.port, self._hli_s))

    def _from_hli(self, outputs: Iterable[Output]) -> None:
        for output in outputs:
            if isinstance(output, ToGuarded):
                if isinstance(output.message, Request | Command):
                    self._send(Link.HLI_SIM, Process.SIM, output.message)
            elif isinstance(output, ToOpen):
                if isinstance(output.message, RobotState):
                    self._send(Link.CONTROLLER_HLI, Process.CONTROLLER, output.message)
            elif output.sender is self.port:
                self._send(Link.CONTROLLER_HLI, Process.CONTROLLER, output.message)
            else:
                output.sender.deliver(output.message)

    def _from_sim(self, outputs: Iterable[SimOutput]) -> None:
        for output in outputs:
            if output.topic in (topics.ADMISSION, topics.SUPERVISION):
                self._send(Link.SIM_SERVER, Process.ROBOT_SERVER, output.message)
            elif output.topic in (topics.GATE_VERDICT, topics.COMMAND_REPLY):
                self._send(Link.HLI_SIM, Process.HLI, output.message)

    # --- beginnings ---------------------------------------------------------------------------------------

    def _new_sim(self) -> Sim:
        self._begun += 1
        return Sim(self.cell, epoch=self._begun)

    def _new_hli(self) -> HliCore:
        first_epoch = round((_BEGAN_S + self.now_s + self.wall_clock_s) * 1000)
        loaded = self._loaded
        return HliCore(self.cell.description, loaded.description, loaded.tool_pose, self._token, first_epoch)

    def _new_controller(self) -> VirtualController:
        return VirtualController(
            self.robot,
            self.cell.robots[self.robot].n,
            self.cell.description.cycle_s,
            float(self.cell.robots[self.robot].home[0]),
            lambda message: self._send(Link.CONTROLLER_HLI, Process.HLI, message),
            self._bad_increment,
        )

    def _token(self) -> str:
        self._tokens += 1
        return f"token-{self._tokens}"
