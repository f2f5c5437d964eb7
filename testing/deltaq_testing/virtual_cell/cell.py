"""The whole stack in one process and in virtual time: the services' own cores, with their messages routed here.

Nothing waits, so it runs faster than real time, and a seed determines all random numbers, so the same controllers
give the same run, bit for bit. Within a cycle messages arrive in the order of their times, so a reply may be late by
a fraction of a cycle, as over UDP. Processes can die, freeze and restart; any wire can be replaced by one that
loses, delays, duplicates and reorders. All other wires are perfect: a message arrives at once.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path

from deltaq_emulator.faults import FaultyLink
from deltaq_protocol.arrays import Array
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.guarded import Admission, Command, CommandReply, Request, ServerState, Supervision
from deltaq_protocol.messages import Message, ResetRequest, RobotState, Status, StopRequest, Verdict
from deltaq_protocol.topic import Realm
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import Output, Sender, ToSender, ToTopic
from deltaq_services.robot_server.rsi_driver import crash_plan
from deltaq_services.sim.core import Sim
from deltaq_testing.virtual_cell.arm import KrcArm, VirtualArm
from deltaq_testing.virtual_cell.clients import (
    ClientPort,
    Connection,
    Say,
    SteppedController,
    VirtualClient,
)
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Life, Link, MessageWire, Process, VirtualProcess

# Which wire carries which message of a virtual cell; where none is plugged in, it arrives as it is sent.

GUARDED_WAYS: dict[type[Message], tuple[Link, Process]] = {
    Admission: (Link.SIM_SERVER, Process.ROBOT_SERVER),
    Supervision: (Link.SIM_SERVER, Process.ROBOT_SERVER),
    Verdict: (Link.HLI_SIM, Process.HLI),
    CommandReply: (Link.HLI_SIM, Process.HLI),
    Request: (Link.HLI_SIM, Process.SIM),
    Command: (Link.HLI_SIM, Process.SIM),
}
"""Route and receiver of a message of the guarded realm."""


class Wiring:
    """The wires between the services of a cell.

    Args:
        arrive: takes each message at its receiver.
    """

    def __init__(self, arrive: Callable[[Process, Message], None]) -> None:
        self._arrive = arrive
        self._wires: dict[tuple[Link, Process, str | None, type[Message] | None], MessageWire] = {}
        self._plugged: list[tuple[MessageWire, Process]] = []
        self._links: list[FaultyLink] = []

    def plug(
        self,
        link: Link,
        to: Process,
        wire: MessageWire,
        robots: Iterable[str | None],
        kind: type[Message] | None = None,
    ) -> None:
        """Carry messages on a wire; see `VirtualCell.plug`."""
        self._wires |= {(link, to, robot, kind): wire for robot in robots}
        self._plugged.append((wire, to))
        self._links.append(wire.link)

    def watch(self, links: Iterable[FaultyLink]) -> None:
        """Also consider messages on links that other code pumps."""
        self._links += links

    def send(self, now_s: float, link: Link, to: Process, message: Message) -> None:
        """Send a message over a link."""
        robot = getattr(message, "robot", None)
        wire = self._wires.get((link, to, robot, type(message))) or self._wires.get((link, to, robot, None))
        if wire is None or wire.perfect:
            self._arrive(to, message)
        else:
            wire.send(now_s, message)

    @property
    def next_s(self) -> float | None:
        """When the next message arrives, on any link; None if none is under way."""
        return min((due_s for link in self._links if (due_s := link.next_s) is not None), default=None)

    def pump(self, now_s: float) -> None:
        """Deliver the messages that are due on the replaced wires."""
        for wire, to in self._plugged:
            for message in wire.take(now_s):
                self._arrive(to, message)


_BEGAN_S = 1e9
"""Time of day at the beginning: epochs and ids are counted from it [s since 1970]."""
_START_CYCLES = 300
_ROUNDING_S = 1e-9


class VirtualCellError(Exception):
    """The robots did not get ready, or a lease was refused."""


class VirtualCell:
    """A cell in virtual time.

    Args:
        cell: the cell, or its name or file.
        start: (n,) configuration of each robot that does not start at home [rad or m].
        seed: of the wires between the KRCs and their Robot Servers.

    Attributes:
        cell: its model.
        arms: its robots.
        states: newest state of each robot, as controllers see it.
        now_s: virtual time.
        cycle_count: cycles so far.
        hli_clock_s: offset of the HLI's clock [s].
        wall_clock_s: offset of the time of day for a new HLI [s].
    """

    def __init__(
        self, cell: str | Path | LoadedCell, start: Mapping[str, Array] | None = None, seed: int = 0
    ) -> None:
        self._loaded = cell if isinstance(cell, LoadedCell) else LoadedCell.load(cell)
        self.cell = self._loaded.model
        self.now_s, self.cycle_count = 0.0, 0
        self.hli_clock_s = self.wall_clock_s = 0.0
        self._epochs = self._tokens = 0
        self._connections: list[Connection] = []
        self._stepped: dict[str, SteppedController] = {}
        self._sim, self._hli = VirtualProcess(self._new_sim), VirtualProcess(self._new_hli)
        self._wiring = Wiring(self._arrive)
        self.states: dict[str, RobotState] = {}
        self.arms = {
            name: self._arm(name, (start or {}).get(name, robot.home), seed)
            for name, robot in self.cell.robots.items()
        }
        self._wiring.watch(link for arm in self.arms.values() for link in arm.links)

    @property
    def sim(self) -> Sim:
        """The gate's core."""
        return self._sim.core

    @property
    def hli(self) -> HliCore:
        """The HLI's core."""
        return self._hli.core

    @property
    def krc_arms(self) -> dict[str, KrcArm]:
        """The robots with an emulated KRC."""
        return {name: arm for name, arm in self.arms.items() if isinstance(arm, KrcArm)}

    # --- time ---------------------------------------------------------------------------------------------

    def cycle(self, robots: Collection[str] | None = None) -> None:
        """One cycle of every robot, or of some whose clocks are ahead, and all that arrives in it."""
        cycle_s = self.cell.description.cycle_s
        self.cycle_count += 1
        self.now_s = self.cycle_count * cycle_s
        end_s = self.now_s + cycle_s
        if self._hli.life is Life.RUNNING:
            self.carry_out(self.hli.on_tick(self._hli_s))
        ticking = [arm for name, arm in self.arms.items() if robots is None or name in robots]
        for arm in ticking:
            arm.begin_cycle(self.now_s)
        # a message due exactly at the end belongs to the next cycle, up to rounding
        while (due_s := self._wiring.next_s) is not None and due_s < end_s - _ROUNDING_S:
            self.now_s = max(self.now_s, due_s)
            self._pump()
        for arm in ticking:
            arm.end_cycle(end_s)

    def run_until_ready(self) -> None:
        """Cycle until the gate has a state of every robot, and every robot a message of the gate.

        Raises:
            VirtualCellError: if that takes too long.
        """
        for _ in range(_START_CYCLES):
            self.cycle()
            phases = {name: self.states[name].phase if name in self.states else None for name in self.arms}
            if all(phase == "ready" for phase in phases.values()):
                return
        raise VirtualCellError(f"the robots are not ready after {_START_CYCLES} cycles: {phases}")

    # --- wires and processes ------------------------------------------------------------------------------

    def plug(
        self,
        link: Link,
        to: Process,
        wire: MessageWire,
        robots: Iterable[str | None],
        kind: type[Message] | None = None,
    ) -> None:
        """Carry messages on a wire that may have faults.

        Args:
            link: between services; a client has its own wires, see `Connection`.
            to: at the receiving end.
            wire: the wire.
            robots: whose messages; None for those of no robot.
            kind: only messages of this kind; None for all that have no wire of their own.
        """
        self._wiring.plug(link, to, wire, robots, kind)

    def process(
        self, process: Process, robot: str
    ) -> VirtualProcess[Sim] | VirtualProcess[HliCore] | VirtualArm:
        """What can be killed, frozen and started: a service; of the Robot Servers, that of `robot`."""
        match process:
            case Process.SIM:
                return self._sim
            case Process.HLI:
                return self._hli
            case Process.ROBOT_SERVER:
                return self.arms[robot]
        raise KeyError(f"no {process} runs here")

    # --- clients ------------------------------------------------------------------------------------------

    def connect(
        self,
        begin: Callable[[Say], VirtualClient],
        up: MessageWire | None = None,
        down: MessageWire | None = None,
    ) -> Connection:
        """Connect a client over wires to the HLI and from it; `begin` makes it from a function that sends."""
        connection = Connection(begin, lambda: self.now_s, self._to_hli, up, down)
        self._connections.append(connection)
        self._wiring.watch(wire.link for wire in (up, down) if wire is not None)
        return connection

    def acquire(self, robot: str, client: str) -> None:
        """Take the lease of a robot for a controller that is asked through `ask`.

        Raises:
            VirtualCellError: if it is refused.
        """
        if robot not in self._stepped:
            connection = self.connect(lambda say: SteppedController(robot, say))
            assert isinstance(connection.core, SteppedController)  # just made
            self._stepped[robot] = connection.core
        if not self._stepped[robot].acquire(client):
            raise VirtualCellError(f"no lease of {robot} for {client}")

    def ask(self, robot: str, dq: Array) -> Verdict | None:
        """Answer a robot's newest state with an increment (n,) [rad or m]; returns the newest verdict, if one came."""
        return self._stepped[robot].ask(dq)

    def kill_client(self, connection: Connection) -> None:
        """End a client's process at once; the HLI sees the connection close."""
        connection.kill()
        client = connection.core
        leases = [] if client.token is None else [(client.robot, client.token)]
        self._hli.do(lambda: self.carry_out(self.hli.requests.on_connection_lost(leases, self._hli_s)))

    def stop(self) -> list[Message]:
        """Press stop; returns the list to which the answer will be appended."""
        return self.request(StopRequest())

    def reset(self, robot: str) -> list[Message]:
        """Ask for a reset; returns the list to which the answer will be appended."""
        return self.request(ResetRequest(robot=robot))

    def request(self, request: Message) -> list[Message]:
        """Send a request of nobody's lease; returns the list to which the answer will be appended."""
        answers: list[Message] = []
        self._to_hli(request, ClientPort(answers.append))
        return answers

    def status(self) -> Status:
        """The cell as the HLI shows it."""
        return self.hli.status(self._hli_s, Counter())

    # --- routing ------------------------------------------------------------------------------------------

    def gate_takes(self, message: Message) -> list[ToTopic]:
        """The gate's answers to a received message."""
        return self.sim.take(message)

    def carry_out(self, outputs: list[Output]) -> None:
        """Send the HLI's outputs, in their order."""
        for output in outputs:
            if isinstance(output, ToSender):
                output.sender.deliver(output.message)
            elif output.topic.realm is Realm.GUARDED:
                self._send(*GUARDED_WAYS[type(output.message)], output.message)
            elif isinstance(output.message, RobotState):
                self.states[output.robot] = output.message
                for connection in self._connections:
                    if connection.core.robot == output.robot:
                        connection.tell(output.message)

    def _publish(self, state: ServerState) -> None:
        self._send(Link.SIM_SERVER, Process.SIM, state)
        self._send(Link.HLI_SERVER, Process.HLI, state)

    def _send(self, link: Link, to: Process, message: Message) -> None:
        self._wiring.send(self.now_s, link, to, message)

    def _arrive(self, to: Process, message: Message) -> None:
        if to is Process.SIM:
            self._sim.do(lambda: self._ask_gate(message))
        elif to is Process.HLI:
            self._to_hli(message, None)
        else:
            assert isinstance(message, Admission | Supervision)  # nothing else is sent to a Robot Server
            self.arms[message.robot].take(message)

    def _ask_gate(self, message: Message) -> None:
        for output in self.gate_takes(message):
            self._send(*GUARDED_WAYS[type(output.message)], output.message)

    def _to_hli(self, said: Message | InvalidMessageError, sender: Sender | None) -> None:
        self._hli.do(lambda: self.carry_out(self.hli.take(said, self._hli_s, sender)))

    def _pump(self) -> None:
        for arm in self.arms.values():
            arm.pump(self.now_s)
        for connection in self._connections:
            connection.pump(self.now_s)
        self._wiring.pump(self.now_s)

    # --- beginnings ---------------------------------------------------------------------------------------

    @property
    def _hli_s(self) -> float:
        return self.now_s + self.hli_clock_s

    def _new_sim(self) -> Sim:
        self._epochs += 1
        return Sim(self.cell, epoch=self._epochs)

    def _new_hli(self) -> HliCore:
        for connection in self._connections:
            connection.core.token = None  # it broke
        first_epoch = round((_BEGAN_S + self.now_s + self.wall_clock_s) * 1000)
        loaded = self._loaded
        return HliCore(self.cell.description, loaded.description, loaded.tool_pose, self._token, first_epoch)

    def _token(self) -> str:
        self._tokens += 1
        return f"token-{self._tokens}"

    def _arm(self, name: str, q: Array, seed: int) -> VirtualArm:
        begin, xml = partial(self._loaded.server, name), self._loaded.ethernet_xml(name)
        if xml is None:
            return VirtualArm(begin, q, self._publish, lambda: self.now_s)
        krc, driver = self._loaded.krc(name, q, xml), partial(self._loaded.driver, xml)
        plan = crash_plan(self.cell.description, name, xml)
        return KrcArm(krc, driver, plan, seed, begin, self._publish, lambda: self.now_s)
