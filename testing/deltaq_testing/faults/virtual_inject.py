"""What makes a robot in virtual time suffer faults, and what ends each of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Address
from deltaq_protocol.messages import Done, Message, Phase
from deltaq_testing.faults.actions import (
    AskPanel,
    BeginInThePast,
    Bombard,
    Freeze,
    Impair,
    Kill,
    Misbehave,
    Misbehaviour,
    PressStop,
    Slow,
    StepClock,
)
from deltaq_testing.faults.bombard import OVERSIZE
from deltaq_testing.faults.catalogue import CHANGE_S, Fault
from deltaq_testing.faults.panel import checked, describe, recovery
from deltaq_testing.virtual_cell.arm import HERE, OTHER_PORT, VirtualArm
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.clients import Say, VirtualClient
from deltaq_testing.virtual_cell.parts import Link, Process, VirtualProcess
from deltaq_testing.virtual_cell.wires import MessageWire

BACK_S = 0.4
"""How long a program that was started again may take."""
ANSWER_CYCLES = 10
"""How long a reset may take to be answered."""

_ENDS = {
    Link.CONTROLLER_HLI: (Process.CONTROLLER, Process.HLI),
    Link.HLI_SIM: (Process.HLI, Process.SIM),
    Link.HLI_SERVER: (Process.ROBOT_SERVER, Process.HLI),
    Link.SIM_SERVER: (Process.SIM, Process.ROBOT_SERVER),
}


class ErringClient(VirtualClient, Protocol):
    """A client that can be made to misbehave."""

    misbehaviour: Misbehaviour | None


class VirtualInjector:
    """Lets faults befall one robot, its controller, and what they share with the others, whose wires are well.

    Args:
        stack: the cell.
        robot: the one that suffers.
        begin: makes its controller, as its process does when it starts.
        seed: of the wires' random numbers.
        cycle: lets a cycle pass.

    Attributes:
        connection: the controller's process.
    """

    def __init__(
        self,
        stack: VirtualCell,
        robot: str,
        begin: Callable[[Say], ErringClient],
        seed: int,
        cycle: Callable[[], None],
    ) -> None:
        self._stack, self._robot, self._cycle = stack, robot, cycle
        self._arm = stack.krc_arms[robot]
        ends = [(link, to) for link, both in _ENDS.items() for to in both]
        self._wires = {end: MessageWire(seed + 10 * number) for number, end in enumerate(ends)}
        for (link, to), wire in self._wires.items():
            if link is not Link.CONTROLLER_HLI:
                stack.plug(link, to, wire, (robot, None))
        down, up = (self._wires[Link.CONTROLLER_HLI, to] for to in _ENDS[Link.CONTROLLER_HLI])
        self._begin = begin
        self.connection = stack.connect(self._new_client, up, down)

    def inject(self, fault: Fault) -> None:
        """Let the fault begin.

        Raises:
            PanelError: the emulated controller is not in a state in which that can happen to it.
        """
        stack = self._stack
        match fault.action:
            case Kill(Process.CONTROLLER):
                stack.kill_client(self.connection)
            case Kill(process) | BeginInThePast(process, _):
                self._process(process).kill()
            case Freeze(process):
                self._process(process).freeze()
            case Slow(_, delay_s):
                self._impair(fault, LinkFaults(delay_s=delay_s))
            case Impair(_, faults):
                self._impair(fault, faults)
            case Misbehave(how):
                self._client.misbehaviour = how
            case StepClock(Process.HLI, by_s):
                stack.hli_clock_s = by_s
            case StepClock(_, by_s):
                self._arm.clock_s = by_s
            case AskPanel(request):
                self._ask_panel(request)
            case Bombard.OVERSIZED:
                self._arm.bombard = _oversized
            case Bombard.PORT_ZERO:
                self._arm.bombard = _from_port_zero
            case PressStop():
                stack.stop()

    def lift(self, fault: Fault) -> list[str]:
        """Let it end; tells what had to be done for that.

        Raises:
            PanelError: the emulated controller is not in a state in which it can end.
        """
        stack = self._stack
        if fault.changes_program:
            self._ask_panel({"op": "stop"})
            self._wait(CHANGE_S)
        if fault.lift is not None:
            self._ask_panel(fault.lift)
        match fault.action:
            case Slow() | Impair():
                self._impair(fault, LinkFaults())
            case Misbehave():
                self._client.misbehaviour = None
            case StepClock(Process.HLI, _):
                stack.hli_clock_s = 0.0
            case StepClock():
                self._arm.clock_s = 0.0
            case Bombard():
                self._arm.bombard = None
            case Kill(process):
                self._process(process).start()
                return [f"restart of the {process}"]
            case BeginInThePast(process, by_s):
                stack.wall_clock_s = by_s
                self._process(process).start()
                return [f"restart of the {process}"]
            case Freeze(process):
                self._process(process).thaw()
        return []

    def bring_back(self) -> list[str]:
        """Do what an operator does so that the robot may move again; tells what that was."""
        steps = []
        requests = recovery(self._arm.krc.state)
        if requests:
            for request in requests:
                self._ask_panel(request)
            steps.append(describe(requests))
            self._wait(BACK_S)
        if self._arm.state is not None and self._arm.state.phase is Phase.HELD and self._reset():
            steps.append("reset")
        return steps

    def _new_client(self, say: Say) -> ErringClient:
        self._client = self._begin(say)
        return self._client

    def _reset(self) -> bool:
        answers: list[Message] = self._stack.reset(self._robot)
        for _ in range(ANSWER_CYCLES):
            self._cycle()
        return any(isinstance(message, Done) for message in answers)

    def _impair(self, fault: Fault, faults: LinkFaults) -> None:
        for (link, to), wire in self._wires.items():
            match fault.action:
                case Slow(process, _) if process in _ENDS[link] and to is not process:
                    wire.link.faults = faults
                case Impair(impaired, _) if link is impaired:
                    wire.link.faults = faults

    def _wait(self, duration_s: float) -> None:
        for _ in range(round(duration_s / self._stack.cell.description.cycle_s)):
            self._cycle()

    def _process(self, process: Process) -> VirtualProcess[Any] | VirtualArm:
        return self.connection if process is Process.CONTROLLER else self._stack.process(process, self._robot)

    def _ask_panel(self, request: Mapping[str, Any]) -> None:
        answers: list[bytes] = []
        self._arm.panel.take(json.dumps(request).encode(), answers.append)
        checked(answers[0])


def _oversized(telegram: bytes) -> tuple[bytes, Address]:
    return telegram + b" " * OVERSIZE, (HERE, OTHER_PORT)


def _from_port_zero(telegram: bytes) -> tuple[bytes, Address]:
    return telegram, (HERE, 0)
