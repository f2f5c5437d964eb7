"""A cell in virtual time for the controller that is tested: its faults come by schedule, and all is recorded."""

import weakref
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from deltaq_emulator.states import KrcState
from deltaq_protocol.messages import Error, Message, Outcome, Phase, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE
from deltaq_testing.faults.controller import CellUseError, VirtualController, begun, deciding
from deltaq_testing.faults.panel import PanelError, load_rsi_cell, must_have, pendant_message
from deltaq_testing.faults.virtual import BACK_S, ErringClient, VirtualInjector
from deltaq_testing.line_controller import ControllerProcess, LineController
from deltaq_testing.observed import Observed
from deltaq_testing.schedule import FaultsOfARun, TimedFault
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.clients import Connection, Say
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

CLIENT = "controller under test"
"""Its name, as the lease has it."""
_START_CYCLES = 100
_ATTEMPTS = 4
_ROUNDING_S = 1e-9


class CellUnderTest(Observed):
    """A cell in virtual time, its robots ready.

    Gate, HLI, Robot Servers and emulated KRCs are the very cores that run in a live cell; there is no clock, and the
    same seed, controller and faults give the same run to the bit.

    Args:
        cell: name or file of a cell whose robots are driven over RSI, or one that is loaded already.
        robot: the one under test; None for the first of the cell.
        seed: of everything that is random, which is what the faults of links do.

    Raises:
        UnknownFaultError: the cell has no such robot, or one that has no KRC.
        CellError: there is no such cell, or its file has errors.

    Attributes:
        seed: of everything that is random.
        verdicts: number of verdicts that the controllers received, by outcome.
        refusals: number of increments that were refused or held, by reason.
        events: faults and other events, with the time since the beginning of the test [s].
    """

    def __init__(
        self, cell: str | Path | LoadedCell = "lab", robot: str | None = None, seed: int = 0
    ) -> None:
        if seed < 0:
            raise CellUseError(f"seed must be 0 or more, got {seed}")
        loaded = cell if isinstance(cell, LoadedCell) else load_rsi_cell(cell, robot)
        must_have(loaded.model.description, robot)
        super().__init__(loaded.model, robot or next(iter(loaded.model.robots)))
        self.seed = seed
        self.verdicts: Counter[Outcome] = Counter()
        self.refusals: Counter[ReasonCode] = Counter()
        self.events: list[tuple[float, str]] = []
        self._stack = VirtualCell(loaded, seed=seed + 100)
        self._running = dict.fromkeys(self.history, 0)
        self._faults = FaultsOfARun()
        self._begun: list[TimedFault] = []
        self._injector: VirtualInjector | None = None
        self._connections: dict[str, Connection] = {}
        self._programs: list[ControllerProcess] = []
        self._record()
        self._get_ready()

    @property
    def phase(self) -> Phase:
        """Phase of the robot; `offline` while its server is dead."""
        return self._own.phases[-1] or Phase.OFFLINE

    @property
    def reason(self) -> ReasonCode | None:
        """Reason for which the robot is held, or None."""
        return self._own.reasons[-1]

    @property
    def reasons(self) -> tuple[ReasonCode, ...]:
        """Reasons of all holds since the beginning of the test, in order."""
        rows = self._own.reasons[self.ready_row :]
        return tuple(
            now for before, now in zip([None, *rows], rows, strict=False) if now not in (None, before)
        )

    @property
    def fault_times_s(self) -> tuple[tuple[float, float], ...]:
        """Beginning and end of each fault that has begun [s]."""
        return tuple((timed.at_s, timed.end_s) for timed in self._begun)

    def account(self) -> str:
        """Cell, robot, seed and events as text, one a line; the seed repeats the run."""
        head = (
            f"cell {self.model.description.cell}, robot {self.robot}, seed {self.seed}, {self.time_s:.3f} s"
        )
        return "\n".join([head, *(f"{time_s:8.3f} s  {what}" for time_s, what in self.events)])

    # --- before -------------------------------------------------------------------------------------------

    def drive(self, controller: Any, robot: str | None = None) -> None:
        """Drive a robot with a controller.

        A fault that kills the controller's process ends with a new process. Then a class makes a new object; a function
        or an object continues as it was.

        Args:
            controller: a function from a `RobotState` to an increment (n,) [rad or m], a list or an array, or to None,
                which leaves the state unanswered; an object with a method `increment(view)` as the controllers of
                `deltaq_controllers` have it; or a class whose objects, made without arguments, are one of these.
            robot: None for the one under test, which suffers the faults; another one has perfect links.

        Raises:
            CellUseError: the robot is driven already, or there is no robot of that name.
        """
        name = self._free(robot)
        states = self._stack.states
        if not isinstance(controller, type):
            deciding(controller, states)  # refused here rather than when its process starts

        def begin(say: Say) -> VirtualController:
            return VirtualController(name, deciding(begun(controller), states), say, CLIENT, self.note)

        self.connect(begin, name)

    def connect(self, begin: Callable[[Say], ErringClient], robot: str | None = None) -> None:
        """Connect a client of your own; `begin` makes it each time its process starts. Otherwise as `drive`."""
        name = self._free(robot)
        if name == self.robot:
            self._injector = VirtualInjector(self._stack, name, begin, self.seed, self._cycle)
            self._connections[name] = self._injector.connection
        else:
            self._connections[name] = self._stack.connect(begin)

    def drive_process(
        self, command: Sequence[str], robot: str | None = None, folder: Path | None = None
    ) -> None:
        """Drive a robot with a program over a socket; virtual time waits for its answers.

        The program speaks JSON lines as with a running cell, and gets the states of the robot that it drives. It
        answers each state with one line: an increment, or the renewal of its lease.

        Args:
            command: the program and its arguments, in which `{port}` stands for the port of 127.0.0.1 to connect to.
            robot: as of `drive`.
            folder: its working folder; None for the present one.

        Raises:
            ControllerProcessError: now or during the run: it cannot be started, or does not answer.
        """
        name = self._free(robot)
        program = ControllerProcess(command, folder)
        weakref.finalize(self, program.close)
        self._programs.append(program)
        self.connect(partial(LineController, name, program, self.note, partial(self._gone, name)), robot)

    def close(self) -> None:
        """End the programs that `drive_process` started."""
        for program in self._programs:
            program.close()

    def suffer(self, *faults: TimedFault) -> None:
        """Schedule faults of the robot under test.

        Raises:
            ScheduleError: one would have had to begin before now, or two change the same part at the same time.
        """
        self._faults.add(faults, self.time_s - _ROUNDING_S)

    # --- the run ------------------------------------------------------------------------------------------

    def run(self, duration_s: float) -> None:
        """Run the cell for a duration; an error of a controller is raised here.

        Raises:
            CellUseError: no controller drives the robot under test.
        """
        if self._injector is None:
            raise CellUseError(f"no controller drives {self.robot}: call drive(controller) before run")
        end_s = self.time_s + duration_s - self.cycle_s / 2
        while self.time_s < end_s:
            self._inject_due(self._injector)
            self._cycle()

    def recover(self) -> bool:
        """Recover as an operator does at the KRC's pendant, then reset; returns whether the robot may move."""
        if self._injector is None:
            raise CellUseError(f"no controller drives {self.robot}: call drive(controller) before recover")
        for _ in range(_ATTEMPTS):
            try:
                steps = self._injector.bring_back()
            except PanelError as error:
                steps = [f"the operator was refused: {error}"]
            for step in steps:
                self._tell(step)
            if self._may_move():
                return True
            for _ in range(round(BACK_S / self.cycle_s)):
                self._cycle()
        return self._may_move()

    # --- cycles -------------------------------------------------------------------------------------------

    def _get_ready(self) -> None:
        for _ in range(_START_CYCLES):
            self._cycle()
            if all(
                name in self._stack.states and history.phases[-1] == "ready"
                for name, history in self.history.items()
            ):
                break
        self.ready_row = len(self._own.q) - 1

    def _inject_due(self, injector: VirtualInjector) -> None:
        for timed, begins in self._faults.due(self.time_s + _ROUNDING_S):
            if begins:
                self.fault_rows.append(len(self._own.q) - 1)
                self._begun.append(timed)
            told = f"{timed.what.name} {'begins' if begins else 'ends'}"
            try:
                (injector.inject if begins else injector.lift)(timed.what)
            except (
                PanelError
            ) as error:  # the emulated controller is in no state for it, such as ended for a stop
                self._tell(f"{told} without effect: {error}")
            else:
                self._tell(f"{told}: {timed.what.what}" if begins else told)

    def _cycle(self) -> None:
        self._stack.cycle()
        self._record()
        before, now = self._own.reasons[-2:]
        if now not in (None, before):
            self._tell(f"{self.robot} is held: {now}")

    def _record(self) -> None:
        for name, history in self.history.items():
            arm = self._stack.krc_arms[name]
            sample, state = arm.krc.sample, arm.state
            history.q.append(sample.q)
            history.setpoints.append(sample.q_setpoint)
            history.phases.append(None if state is None else state.phase)
            history.reasons.append(None if state is None else state.reason)
            self._running[name] += sample.state is KrcState.RSI_RUNNING
            history.unanswered = sample.counters["unanswered"] + self._running[name] - sample.counters["sent"]
            history.altered = arm.to_pc.counts["flipped"]
            history.protest = history.protest or pendant_message(sample.message)

    def note(self, message: Message) -> None:
        """Count a message to a controller; a client that `connect` makes may pass its messages here."""
        match message:
            case Verdict():
                self.verdicts[message.outcome] += 1
                if message.outcome in (Outcome.REFUSED, Outcome.HELD):
                    self.refusals.update(reason.code for reason in message.reasons)
            case Error():
                self.refusals[message.code] += 1

    # --- the controller -----------------------------------------------------------------------------------

    def _free(self, robot: str | None) -> str:
        name = robot or self.robot
        if name not in self.history:
            raise CellUseError(f"no robot {name!r} in this cell; it has {', '.join(self.history)}")
        if name in self._connections:
            raise CellUseError(f"{name} has a controller already: one controller a robot, one cell a test")
        return name

    def _gone(self, robot: str) -> None:
        self._tell(f"the controller of {robot} has closed its connection")
        self._stack.kill_client(self._connections[robot])

    def _may_move(self) -> bool:
        return self.phase in MAY_MOVE and self._stack.krc_arms[self.robot].krc.state is KrcState.RSI_RUNNING

    def _tell(self, what: str) -> None:
        self.events.append((self.time_s, what))
