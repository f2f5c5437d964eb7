"""Faults in virtual time: move, inject, watch, lift, bring back, judge; and the table of their effects."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from deltaq_emulator.faults import LinkFaults
from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array
from deltaq_protocol.endpoint import Address
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Done, Message, Phase, RobotState
from deltaq_testing.faults.bombard import OVERSIZE
from deltaq_testing.faults.catalogue import (
    CATALOGUE,
    CHANGE_S,
    AskPanel,
    BeginInThePast,
    Bombard,
    Fault,
    Freeze,
    Impair,
    Kill,
    Misbehave,
    Misbehaviour,
    PressStop,
    Slow,
    StepClock,
    UnknownFaultError,
)
from deltaq_testing.faults.controller import VirtualController
from deltaq_testing.faults.mover import CRUISE_RAD_S, Mover
from deltaq_testing.faults.panel import checked, describe, load_rsi_cell, pendant_message, recovery
from deltaq_testing.faults.report import (
    NEVER,
    FaultEffect,
    FaultTable,
    is_good,
    judged,
    motion_after,
    recovery_text,
)
from deltaq_testing.oracle import TELEGRAM_STEP, ClearanceOracle
from deltaq_testing.virtual_cell.arm import HERE, OTHER_PORT, VirtualArm
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.clients import Say, VirtualClient
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Life, Link, MessageWire, Process, VirtualProcess

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
    """Injects faults into one robot, its controller and the shared services; the wires of other robots stay intact.

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
        """End the fault; returns the actions that were needed.

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
        """Do what an operator does until the robot may move again; returns the actions."""
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


CRUISE_CYCLES = 40
"""From the first full increment to the fault."""
FAULT_S = 1.4
"""How long a fault stands: longer than every timeout of the shipped cells, and a brake after it."""
ATTEMPTS = 4
_START_CYCLES = 300


def run_fault(fault: Fault, loaded: LoadedCell, robot: str, seed: int = 0) -> FaultEffect:
    """Let a moving robot suffer one fault.

    Args:
        fault: from the catalogue.
        loaded: the cell.
        robot: the one that moves.
        seed: of the wires' random numbers.

    Raises:
        DeltaqError: if the robot never got to its cruising speed.
    """
    run = _Run(loaded, robot, seed)
    run.reach_cruise()
    injected = len(run.setpoints) - 1
    run.injector.inject(fault)
    named = None
    for cycle in range(round(FAULT_S / run.cycle_s)):
        run.cycle()
        if named is None and run.phase() is Phase.HELD:
            named = (cycle + 1) * run.cycle_s
    motion = motion_after(run.model, np.array(run.setpoints[injected:]), run.cycle_s, run.cruise)
    # a Robot Server that does not run leaves the HLI with an old state, which it shows as offline
    state = run.arm.state if run.arm.life is Life.RUNNING else None
    phase = Phase.OFFLINE if state is None else state.phase
    recovery = run.recover(fault)
    sample = run.arm.krc.sample
    kept = judged(
        run.model,
        np.array(run.setpoints),
        run.cycle_s,
        # in a cycle in which its program ends, the KRC has sent and runs no more
        sample.counters["unanswered"] + max(0, run.running - sample.counters["sent"]),
        (run.least_m, run.least_own_m),
        run.protest,
        run.arm.to_pc.counts["flipped"],
    )
    gate = run.stack.cell.description.gate
    return FaultEffect(
        fault=fault.name,
        what=fault.what,
        live=False,
        motion=motion,
        phase=phase,
        reason=None if state is None else state.reason,
        named_after_s=named,
        recovery=recovery,
        kept=kept,
        good=recovery != NEVER and is_good(kept, (gate.stop_distance_m, gate.self_stop_distance_m)),
    )


class _Run:
    """A cell, the record of its robot, and the independent checker."""

    def __init__(self, loaded: LoadedCell, robot: str, seed: int) -> None:
        self.stack = VirtualCell(loaded, seed=seed + 100)
        self.robot = robot
        self.model = self.stack.cell.robots[robot]
        self.arm = self.stack.krc_arms[robot]
        self.cycle_s = self.stack.cell.description.cycle_s
        self.cruise = float(CRUISE_RAD_S * self.cycle_s)
        self.injector = VirtualInjector(self.stack, robot, self._new_mover, seed, self.cycle)
        self.setpoints: list[Array] = [self.arm.krc.sample.q_setpoint]
        self.running = 0
        self.least_m = self.least_own_m = np.inf
        self.protest: str | None = None
        self._oracle = ClearanceOracle(self.stack.cell)

    def cycle(self) -> None:
        """One cycle, recorded."""
        self.stack.cycle()
        sample = self.arm.krc.sample
        self.setpoints.append(sample.q_setpoint)
        self.running += sample.state is KrcState.RSI_RUNNING
        self.protest = self.protest or pendant_message(sample.message)
        actual = {name: arm.q for name, arm in self.stack.arms.items()}
        self.least_m = min(self.least_m, self._oracle.between_robots_and_structure(actual).distance_m)
        self.least_own_m = min(self.least_own_m, self._oracle.of_one_robot(actual).distance_m)

    def phase(self) -> Phase | None:
        """Phase of the robot as its server shows it; None while it is dead or has not begun."""
        return None if self.arm.state is None else self.arm.state.phase

    def reach_cruise(self) -> None:
        """Cycle until the robot has moved at its cruising speed for a while."""
        for _ in range(_START_CYCLES):
            self.cycle()
            if self._step() > self.cruise - TELEGRAM_STEP:
                break
        else:
            raise DeltaqError(f"{self.robot} did not reach its speed in {_START_CYCLES} cycles")
        for _ in range(CRUISE_CYCLES):
            self.cycle()

    def recover(self, fault: Fault) -> str:
        """End the fault and recover until the robot moves; returns the actions."""
        steps = self.injector.lift(fault)
        for _ in range(ATTEMPTS):
            if self._moves():
                return recovery_text(steps)
            steps += self.injector.bring_back()
        return recovery_text(steps) if self._moves() else NEVER

    def _moves(self) -> bool:
        for _ in range(round(BACK_S / self.cycle_s)):
            self.cycle()
            # the rest of a brake that was interrupted is motion too, but none that was asked for
            if self._step() > self.cruise / 2 and self.phase() is Phase.ENGAGED:
                return True
        return False

    def _step(self) -> float:
        return float(np.abs(self.setpoints[-1] - self.setpoints[-2]).max())

    def _new_mover(self, say: Say) -> VirtualController:
        mover = Mover(self.model.n, self.cycle_s, float(self.model.home[0]))

        def decide(state: RobotState) -> Array:
            return mover.increment(state.q_cmd)

        return VirtualController(self.robot, decide, say)


# The table of faults: produced in virtual time, and as people read it.

COLUMNS = (
    "fault",
    "braked after [cycles]",
    "at rest after [ms]",
    "travel [deg]",
    "tool [mm]",
    "phase",
    "reason",
    "named after [ms]",
    "KRC cycles unanswered",
    "abrupt",
    "clearance [mm]",
    "moves again",
    "good",
)
GOES_ON = "goes on"


def run_table(
    cell_name: str | Path = "lab",
    robot: str | None = None,
    *,
    faults: Sequence[Fault] = CATALOGUE,
    seed: int = 0,
    on_row: Callable[[int, int], None] | None = None,
) -> FaultTable:
    """Inject fault after fault in virtual time while one robot moves.

    Args:
        cell_name: name or file of a cell whose robots are driven over RSI.
        robot: the moving robot; None for the first of the cell.
        faults: from the catalogue; those that are not possible in virtual time are left out.
        seed: of the wires' random numbers.
        on_row: called with the number of rows done and the number of all.

    Raises:
        UnknownFaultError: if the robot is not the cell's, or no fault is left to be run.
    """
    loaded = load_rsi_cell(cell_name, robot)
    name = robot or next(iter(loaded.model.robots))
    chosen = [fault for fault in faults if fault.virtual]
    if not chosen:
        raise UnknownFaultError(
            "none of these faults is possible in virtual time; `deltaq fault list` shows which can"
        )
    rows: list[FaultEffect] = []
    for fault in chosen:
        rows.append(run_fault(fault, loaded, name, seed))
        if on_row is not None:
            on_row(len(rows), len(chosen))
    return table_of(loaded, name, rows)


def table_of(loaded: LoadedCell, robot: str, rows: Sequence[FaultEffect]) -> FaultTable:
    """The rows of a robot as a table."""
    return FaultTable(
        cell=loaded.model.description.cell,
        robot=robot,
        cycle_s=loaded.model.description.cycle_s,
        cruise_rad_s=float(CRUISE_RAD_S),
        rows=tuple(rows),
    )


def shown(row: FaultEffect) -> tuple[str, ...]:
    """A row under `COLUMNS` as text, in degrees and millimetres."""
    motion, kept = row.motion, row.kept
    if motion.rest_after_s is None or motion.travel_rad is None or motion.travel_tool_m is None:
        until_rest = (GOES_ON, "-", "-")
    else:
        until_rest = (
            f"{motion.rest_after_s * 1000:.0f}",
            f"{math.degrees(motion.travel_rad):.2f}",
            f"{motion.travel_tool_m * 1000:.1f}",
        )
    return (
        row.fault,
        "-" if motion.braked_after_cycles is None else str(motion.braked_after_cycles),
        *until_rest,
        row.phase,
        row.reason or "-",
        "-" if row.named_after_s is None else f"{row.named_after_s * 1000:.0f}",
        str(kept.unanswered_cycles),
        str(kept.abrupt_cycles),
        f"{kept.clearance_m * 1000:.0f}",
        row.recovery,
        "yes" if row.good else "no",
    )


def markdown(table: FaultTable) -> str:
    """The table for a page of the documentation."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *map(shown, table.rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
