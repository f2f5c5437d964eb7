"""One fault in virtual time: move, inject, watch, lift, bring back, judge."""

from __future__ import annotations

import numpy as np

from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Phase, RobotState
from deltaq_testing.faults.catalogue import Fault
from deltaq_testing.faults.controller import VirtualController
from deltaq_testing.faults.mover import CRUISE_RAD_S, Mover
from deltaq_testing.faults.panel import pendant_message
from deltaq_testing.faults.report import NEVER, FaultEffect, is_good, judged, motion_after, recovery_text
from deltaq_testing.faults.virtual_inject import BACK_S, VirtualInjector
from deltaq_testing.oracle import TELEGRAM_STEP, ClearanceOracle
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.clients import Say
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Life

CRUISE_CYCLES = 40
"""From the first full increment to the fault."""
FAULT_S = 1.4
"""How long a fault stands: longer than every timeout of the shipped cells, and a brake after it."""
ATTEMPTS = 4
_START_CYCLES = 300


class FaultRunError(DeltaqError):
    """The robot did not move before there was any fault."""


def run_fault(fault: Fault, loaded: LoadedCell, robot: str, seed: int = 0) -> FaultEffect:
    """Let a moving robot suffer one fault.

    Args:
        fault: from the catalogue.
        loaded: the cell.
        robot: the one that moves.
        seed: of the wires' random numbers.

    Raises:
        FaultRunError: if the robot never got to its cruising speed.
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
        sample.counters["unanswered"] + run.running - sample.counters["sent"],
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
    """A cell, the record of its robot, and the oracle that watches."""

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
            raise FaultRunError(f"{self.robot} did not reach its speed in {_START_CYCLES} cycles")
        for _ in range(CRUISE_CYCLES):
            self.cycle()

    def recover(self, fault: Fault) -> str:
        """Lift the fault and do what it takes until the robot moves; tells what it took."""
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
