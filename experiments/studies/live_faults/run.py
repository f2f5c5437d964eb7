"""Faults over real processes, zenoh and UDP, read from the emulated controllers' own records."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from deltaq_deploy.launch.cell_connection import connect
from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.faults.catalogue import (
    CATALOGUE,
    BeginInThePast,
    Fault,
    Freeze,
    Impair,
    Kill,
    PressStop,
    UnknownFaultError,
)
from deltaq_testing.faults.mover import CRUISE_RAD_S, SWING_RAD
from deltaq_testing.faults.panel import PanelError, describe, load_rsi_cell, pendant_message, recovery
from deltaq_testing.faults.report import (
    NEVER,
    FaultEffect,
    FaultTable,
    is_good,
    judged,
    motion_after,
    recovery_text,
)
from deltaq_testing.faults.virtual import ATTEMPTS, table_of
from deltaq_testing.oracle import ClearanceOracle, record_cycle_s, rows_of
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Process
from studies.live_faults.injector import EveryFaultInjector
from studies.live_faults.moving_cell import MovingCell, Needs, moving_cell

CRUISE_S = 0.4
"""From the first full increments to the fault."""
FAULT_S = 1.6
"""How long a fault stands."""
BACK_S = 3.0
"""How long the robot may take to move again; a process that comes back has to be found by the others."""
_START_S = 60.0
_MOVES = 0.25
"""Share of the cruising speed from which the robot counts as moving: a loaded machine brakes it now and then."""
_CRUISES = 0.9
"""Share from which it counts as cruising."""
_POLL_S = 0.02
_CYCLES_SEEN = 4
"""Cycles between two looks at the setpoint that are enough to tell a speed."""
_CYCLES_MOVED = 25
"""Cycles between two looks that tell motion from the rest of a brake that was interrupted."""


def live_table(
    cell: str | Path, robot: str | None, faults: Sequence[Fault] = CATALOGUE, seed: int = 0
) -> FaultTable:
    """Let one robot suffer fault after fault; those that real processes cannot suffer are left out.

    Raises:
        UnknownFaultError: if the robot is not the cell's, or no fault is left to be run.
    """
    loaded = load_rsi_cell(cell, robot)
    name = robot or next(iter(loaded.model.robots))
    chosen = [fault for fault in faults if fault.live]
    if not chosen:
        raise UnknownFaultError("none of these faults can be had live; run `deltaq fault table`")
    rows: dict[str, FaultEffect] = {}

    def add(row: FaultEffect) -> None:
        rows[row.fault] = row
        print(f"{len(rows)} of {len(chosen)}: {row.fault}, {'good' if row.good else 'not good'}", flush=True)

    run_live_faults(chosen, loaded, name, add, seed)
    return table_of(loaded, name, [rows[fault.name] for fault in chosen])


def run_live_faults(
    faults: Sequence[Fault],
    loaded: LoadedCell,
    robot: str,
    on_row: Callable[[FaultEffect], None],
    seed: int = 0,
) -> None:
    """Start the cell's services, inject fault after fault while a robot moves, and end everything.

    Faults of one wire share a cell with a relay in that wire; others have no relay in their way.

    Args:
        faults: those that can be injected live.
        loaded: the cell; no other process may run it.
        robot: the moving robot.
        on_row: called with each row.
        seed: of the relays' random numbers.

    Raises:
        LaunchError: if a service does not come up.
        DeltaqError: if the robot never got to its cruising speed.
        NoCompilerError: if clocks are to be set, and the library for that cannot be made.
    """
    waiting: dict[Needs, list[Fault]] = {}
    for fault in faults:
        waiting.setdefault(Needs.of(fault), []).append(fault)
    for needs, group in waiting.items():
        while group:
            with moving_cell(loaded, robot, needs, seed) as cell:
                while group:
                    fault = group.pop(0)
                    row = _Run(cell, loaded, robot).suffer(fault)
                    on_row(row)
                    if row.recovery == NEVER or needs.alone:
                        break  # the rest suffers in a cell that is well


def _takes_the_hli_away(fault: Fault) -> bool:
    match fault.action:
        case Kill(Process.HLI) | Freeze(Process.HLI) | BeginInThePast(Process.HLI, _):
            return True
    return False


def _flipped(status: dict[str, Any]) -> int:
    return int(status["faults"]["to_pc"]["counts"]["flipped"])


class _Run:
    """One fault in a cell of real processes."""

    def __init__(self, running: MovingCell, loaded: LoadedCell, robot: str) -> None:
        self._launcher, self._panel, self._records = running.launcher, running.panel, running.records
        self._injector = EveryFaultInjector(running, loaded, robot)
        self._cell, self._robot = loaded.model, robot
        self._description = loaded.model.description
        self._cruise = float(CRUISE_RAD_S * self._description.cycle_s)
        self._home = float(loaded.model.robots[robot].home[0])

    def suffer(self, fault: Fault) -> FaultEffect:
        """Move, inject, watch, lift, bring back, judge."""
        self._injector.prepare(fault)
        self._wait_for_room()
        begun = self._status()
        time.sleep(CRUISE_S)
        phase, reason, named, injected = self._watch(fault)
        lifted = self._status()
        steps = self._injector.lift(fault)
        if phase is None:
            phase, reason = self._phase()
        recovery = self._recover(steps)
        ended = self._status()
        record = self._records[self._robot]
        cycle_s = record_cycle_s(record)
        rows = rows_of(record)
        rows = rows[(rows[:, 0] >= begun["cycle"]) & (rows[:, 0] < ended["cycle"])]
        model = self._cell.robots[self._robot]
        setpoints = rows[:, 1 + model.n : 1 + 2 * model.n]
        counters = {
            name: ended["counters"][name] - begun["counters"][name] for name in ("unanswered", "sent")
        }
        unanswered = counters["unanswered"] + max(0, int(rows[:, -1].sum()) - counters["sent"])
        fault_rows = (rows[:, 0] >= injected) & (rows[:, 0] <= lifted["cycle"])
        kept = judged(
            model,
            setpoints,
            cycle_s,
            unanswered,
            self._nearest(rows[:, 1 : 1 + model.n]),
            pendant_message(lifted["message"]),
            _flipped(ended) - _flipped(begun),
            altered_replies=isinstance(fault.action, Impair) and fault.action.faults.flip > 0,
        )
        gate = self._description.gate
        return FaultEffect(
            fault=fault.name,
            what=fault.what,
            live=True,
            motion=motion_after(model, setpoints[fault_rows], cycle_s, self._cruise),
            phase=phase,
            reason=reason,
            named_after_s=named,
            recovery=recovery,
            kept=kept,
            good=recovery != NEVER and is_good(kept, (gate.stop_distance_m, gate.self_stop_distance_m)),
        )

    # --- before -------------------------------------------------------------------------------------------

    def _wait_for_room(self) -> None:
        """Until the robot cruises, and so far from where it turns that it will not turn while it is watched."""
        needed = CRUISE_RAD_S * (CRUISE_S + FAULT_S)
        deadline, fastest = time.monotonic() + _START_S, 0.0
        while time.monotonic() < deadline:
            before, after, cycles = self._two_looks()
            way = after[0] - self._home
            left = SWING_RAD - way if after[0] > before[0] else way
            step = abs(after[0] - before[0]) / cycles
            if step > self._cruise * _CRUISES and left > needed:
                return
            if step == 0.0:
                self._reset()  # a busy machine may have lost the KRC while the cell came up
            fastest = max(fastest, step)
        phase, reason = self._phase()
        raise DeltaqError(
            f"{self._robot} did not get to its cruising speed with room to go on within {_START_S:g} s: it is {phase}"
            f"{f' ({reason})' if reason else ''}, the fastest seen was {fastest / self._cruise:.0%} of that; is the "
            "machine busy with other work?"
        )

    # --- while the fault stands ---------------------------------------------------------------------------

    def _watch(self, fault: Fault) -> tuple[Phase | None, ReasonCode | None, float | None, int]:
        """Inject, and tell phase, reason, when it was held, and the KRC's cycle of the fault.

        There is no phase where the HLI cannot be asked.
        """
        deadline = time.monotonic() + FAULT_S
        if _takes_the_hli_away(fault):
            cycle = self._status()["cycle"]
            self._injector.inject(fault)
            time.sleep(FAULT_S)
            return None, None, None, cycle
        phase, reason, named = None, None, None
        with connect(self._description, "deltaq fault") as running:
            cycle, injected_s = self._status()["cycle"], time.monotonic()
            if isinstance(fault.action, PressStop):
                running.stop()
            else:
                self._injector.inject(fault)
            while (now_s := time.monotonic()) < deadline:
                # an HLI whose clock leapt takes its sessions for lost, this one among them
                with suppress(ServiceUnreachableError):
                    status = running.status().robots[self._robot]
                    phase, reason = status.phase, status.reason if status.phase is Phase.HELD else None
                    if named is None and status.phase is Phase.HELD:
                        named = now_s - injected_s
                time.sleep(_POLL_S)
        return phase, reason, named, cycle

    # --- afterwards ---------------------------------------------------------------------------------------

    def _recover(self, steps: list[str]) -> str:
        for _ in range(ATTEMPTS):
            if self._moves():
                return recovery_text(steps)
            requests = recovery(self._status()["state"])
            if requests:
                for request in requests:
                    self._panel.ask(request)
                steps.append(describe(requests))
                with suppress(PanelError):  # it stopped again; the next attempt sees that
                    self._panel.ask({"op": "await", "state": KrcState.RSI_RUNNING, "within_s": BACK_S})
            if self._reset():
                steps.append("reset")
        return recovery_text(steps) if self._moves() else NEVER

    def _reset(self) -> bool:
        try:
            with connect(self._description, "deltaq fault") as running:
                if running.status().robots[self._robot].phase is not Phase.HELD:
                    return False
                running.reset(self._robot)
        except (RefusedError, ServiceUnreachableError):
            return False  # asked again, until the attempts are used up
        return True

    def _phase(self) -> tuple[Phase, ReasonCode | None]:
        """The robot's phase at the HLI, once the HLI is back and has a state."""
        deadline = time.monotonic() + _START_S
        while True:
            with connect(self._description, "deltaq fault") as running:
                status = running.status().robots[self._robot]
            if status.phase is not Phase.OFFLINE or time.monotonic() > deadline:
                return status.phase, status.reason
            time.sleep(_POLL_S)

    def _moves(self) -> bool:
        deadline = time.monotonic() + BACK_S
        while time.monotonic() < deadline:
            before, after, cycles = self._two_looks(_CYCLES_MOVED)
            if abs(after[0] - before[0]) > cycles * self._cruise * _MOVES:
                return True
        return False

    def _nearest(self, q: Array) -> tuple[float, float]:
        """Least distances over configurations (k, n) of the robot, the others where they stood last."""
        oracle = ClearanceOracle(self._cell)
        others = {
            name: rows_of(path)[-1, 1 : 1 + self._cell.robots[name].n]
            for name, path in self._records.items()
            if name != self._robot
        }
        moments = [others | {self._robot: row} for row in q]
        return (
            min(oracle.between_robots_and_structure(moment).distance_m for moment in moments),
            min(oracle.of_one_robot(moment).distance_m for moment in moments),
        )

    # --- processes and panel ------------------------------------------------------------------------------

    def _status(self) -> dict[str, Any]:
        return self._panel.ask({"op": "status"})

    def _two_looks(self, apart: int = _CYCLES_SEEN) -> tuple[Array, Array, int]:
        """Two setpoints (n,) [rad or m] and the cycles between them."""
        before = self._status()
        after = self._panel.ask({"op": "await", "cycles": apart})
        return np.array(before["q_setpoint"]), np.array(after["q_setpoint"]), after["cycle"] - before["cycle"]
