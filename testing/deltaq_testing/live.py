"""A cell of real processes on ports of its own for the controller that is tested."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from deltaq_cell.description import RsiDescription
from deltaq_cell.description.cell import CellDescription
from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service, cell_services
from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Phase, RobotStatus
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE
from deltaq_testing.faults.bombard import Bomber
from deltaq_testing.faults.catalogue import CHANGE_S, AskPanel, Bombard, Fault, Freeze, Kill, PressStop
from deltaq_testing.faults.controller import CellUseError
from deltaq_testing.faults.panel import PanelClient, PanelError, load_rsi_cell, pendant_message, recovery
from deltaq_testing.observed import Observed, RobotHistory
from deltaq_testing.oracle import record_cycle_s, rows_of
from deltaq_testing.private_cell import write_private_cell
from deltaq_testing.schedule import FaultsOfARun, ScheduleError, TimedFault
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Process

_SERVICES = (Process.HLI, Process.SIM, Process.ROBOT_SERVER)


def applies_live(fault: Fault) -> bool:
    """Whether the fault can be injected into a live cell under test: into one of its services or its KRC."""
    match fault.action:
        case Kill(process) | Freeze(process):
            return process in _SERVICES
        case Bombard():
            return fault.action is not Bombard.PORT_ZERO  # which needs a privilege
    return isinstance(fault.action, AskPanel | PressStop)


class Injector:
    """Injects faults into a running cell.

    Args:
        launcher: of its services.
        panel: of the robot's emulated controller.
        cell: its description.
        robot: the one that suffers.
    """

    def __init__(self, launcher: Launcher, panel: PanelClient, cell: CellDescription, robot: str) -> None:
        self.launcher, self.panel, self.cell, self.robot = launcher, panel, cell, robot
        self._bomber: Bomber | None = None

    def inject(self, fault: Fault) -> None:
        """Let the fault begin."""
        match fault.action:
            case Kill(process):
                self.signal(process, signal.SIGKILL)
            case Freeze(process):
                self.signal(process, signal.SIGSTOP)
            case AskPanel(request):
                self.panel.ask(request)
            case Bombard():
                driver = self.cell.robots[self.robot].driver
                assert isinstance(driver, RsiDescription)  # `load_rsi_cell` has seen to that
                self._bomber = Bomber(fault.action, (driver.address, driver.port))
                self._bomber.__enter__()

    def lift(self, fault: Fault) -> list[str]:
        """End the fault; returns the actions that were needed."""
        if fault.changes_program:
            self.panel.ask({"op": "stop"})
            time.sleep(CHANGE_S)
        if fault.lift is not None:
            self.panel.ask(fault.lift)
        match fault.action:
            case Kill(process):
                return self.restart(process)
            case Freeze(process):
                self.signal(process, signal.SIGCONT)
            case Bombard():
                assert self._bomber is not None  # it was started
                self._bomber.__exit__()
        return []

    def restart(self, process: Process) -> list[str]:
        """Restart a process; returns the action as text."""
        self.launcher.restart(self.service(process))
        return [f"restart of the {process}"]

    def service(self, process: Process) -> str:
        """The service name of a process."""
        return f"{process}-{self.robot}" if process is Process.ROBOT_SERVER else str(process)

    def pid(self, process: Process) -> int:
        """Its process id."""
        return self.launcher.children[self.service(process)].pid

    def signal(self, process: Process, number: signal.Signals) -> None:
        """Send it and its children a signal."""
        os.killpg(self.pid(process), number)


CLIENT = "deltaq testing"
_BACK_S = 20.0
"""How long a cell may take to be ready again."""
_PROGRAM_S = 3.0
"""How long a program that was started may take to run."""
_POLL_S = 0.02
_RECORD_BYTES = 50_000_000
"""Of a record that the next test cuts short, so that hours of tests fill no disk."""
_APPROACH = 0.2
"""Share of the remaining way home that one increment asks for: one or two are in flight."""
_HOME_SHARE = 0.1
"""Share of the largest increment with which a robot is brought home."""


class LiveCell(Observed):
    """A cell of real processes, which the controller under test connects to by itself, over zenoh or a socket.

    Its findings come from the emulated controllers' records since the test began. Live runs do not repeat exactly:
    assert only what holds on a busy machine, too.

    Args:
        loaded: the cell; no other process runs it.
        robot: the robot under test.
        launcher: of its processes.
        panels: of each robot's emulated controller.
        records: that these write, by robot.

    Attributes:
        url: address of its HLI for zenoh clients.
        tcp_port: its port for JSON lines, on 127.0.0.1.
    """

    def __init__(
        self,
        loaded: LoadedCell,
        robot: str,
        launcher: Launcher,
        panels: dict[str, PanelClient],
        records: dict[str, Path],
    ) -> None:
        super().__init__(loaded.model, robot)
        description = loaded.model.description
        self.url, self.tcp_port = description.hli, description.tcp_port
        self._launcher, self._panels, self._records = launcher, panels, records
        self._injector = Injector(launcher, panels[robot], description, robot)
        self._faults = FaultsOfARun()
        self._programs: list[subprocess.Popen[bytes]] = []
        self.begin()

    @property
    def time_s(self) -> float:
        """Time since the test began [s]."""
        return time.monotonic() - self._began_s

    @property
    def pids(self) -> dict[str, int]:
        """The processes of the cell, by name."""
        return {name: child.pid for name, child in self._launcher.children.items()}

    @property
    def phase(self) -> Phase:
        """Phase of the robot, as the HLI shows it."""
        return self._status().phase

    @property
    def reason(self) -> ReasonCode | None:
        """Why the robot is held; None while it is not."""
        return self._status().reason

    def drive_process(self, command: Sequence[str], folder: Path | None = None) -> None:
        """Start a controller as a program of its own, which connects by itself; it is ended with the test.

        Args:
            command: the program and its arguments, in which `{port}` stands for `tcp_port` and `{url}` for `url`.
            folder: its working folder; None for the present one.

        Raises:
            CellUseError: it cannot be started.
        """
        given = {"{port}": str(self.tcp_port), "{url}": self.url}
        words = [str(word) for word in command]
        for mark, value in given.items():
            words = [word.replace(mark, value) for word in words]
        try:
            self._programs.append(subprocess.Popen(words, cwd=folder))
        except (OSError, IndexError) as error:
            raise CellUseError(f"command {words} cannot be started: {error}") from None

    def end_programs(self) -> None:
        """`kill -9` of the programs that drive."""
        while self._programs:
            program = self._programs.pop()
            program.kill()
            program.wait()

    def suffer(self, *faults: TimedFault) -> None:
        """Schedule faults of the cell; times are counted from the beginning of the test.

        Raises:
            ScheduleError: one is not possible here, begins in the past, or two change the same part.
        """
        for timed in faults:
            if not applies_live(timed.what):
                raise ScheduleError(
                    f"{timed.what.name} cannot be injected into a live cell under test; take virtual_cell, or a fault "
                    "of hli, sim, robot-server or the KRC"
                )
        self._faults.add(faults, self.time_s)

    def run(self, duration_s: float) -> None:
        """Wait for so long while the scheduled faults are injected; then read the recording."""
        end_s = self.time_s + duration_s
        while (now_s := self.time_s) < end_s:
            for timed, begins in self._faults.due(now_s):
                if begins:
                    self.fault_rows.append(self._cycle_of(self.robot) - self._first[self.robot]["cycle"])
                    self._inject(timed)
                else:
                    self._injector.lift(timed.what)
            time.sleep(_POLL_S)
        self._read()

    def recover(self) -> bool:
        """Recover as an operator does at the pendant, then reset; returns whether the robot may move."""
        deadline = time.monotonic() + _BACK_S
        while time.monotonic() < deadline:
            with suppress(PanelError, RefusedError, ServiceUnreachableError):
                for name, panel in self._panels.items():
                    _bring_back(panel)
                    with connect(self.model.description, CLIENT) as cell:
                        if cell.status().robots[name].phase is Phase.HELD:
                            cell.reset(name)
                with connect(self.model.description, CLIENT) as cell:
                    robots = cell.status().robots.values()
                if all(robot.phase in MAY_MOVE for robot in robots):
                    return True
            time.sleep(_POLL_S)
        return False

    def renew(self) -> bool:
        """Make it ready for the next test: faults lifted, robots free and the one under test at home; whether it is."""
        self.end_programs()
        for timed in self._faults.drop():
            self._injector.lift(timed.what)
        if not self.recover():
            return False
        self._go_home()
        self.begin()
        return True

    # --- how it is done -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Begin a test: only records from now on count."""
        for record in self._records.values():
            if record.stat().st_size > _RECORD_BYTES:
                os.truncate(record, 0)
        self._from_byte = {name: record.stat().st_size for name, record in self._records.items()}
        self.fault_rows = []
        self._first = {name: panel.ask({"op": "status"}) for name, panel in self._panels.items()}
        self._began_s = time.monotonic()

    def _status(self) -> RobotStatus:
        with connect(self.model.description, CLIENT) as cell:
            return cell.status().robots[self.robot]

    def _cycle_of(self, robot: str) -> int:
        return int(self._panels[robot].ask({"op": "status"})["cycle"])

    def _inject(self, timed: TimedFault) -> None:
        if isinstance(timed.what.action, PressStop):
            with connect(self.model.description, CLIENT) as cell:
                cell.stop()
        else:
            self._injector.inject(timed.what)

    def _go_home(self) -> None:
        home, limits = self.home, self.model.robots[self.robot].max_velocity * self.cycle_s * _HOME_SHARE
        with connect(self.model.description, CLIENT) as cell, cell.lease(self.robot) as robot:
            for state in robot.states():
                missing = home - np.array(state.q_cmd)
                if np.abs(missing).max() < 1e-5:
                    return
                robot.send(np.clip(_APPROACH * missing, -limits, limits).tolist())

    def _read(self) -> None:
        """Read the emulated controllers' records since the test began, the same number of cycles of each."""
        rows = {name: self._rows(name) for name in self._records}
        count = min(map(len, rows.values()))
        for name, all_rows in rows.items():
            n, last = self.model.robots[name].n, self._panels[name].ask({"op": "status"})
            kept = all_rows[len(all_rows) - count :]
            unanswered = self._since(name, last, "unanswered") + max(
                0, int(all_rows[:, -1].sum()) - self._since(name, last, "sent")
            )
            self.history[name] = RobotHistory(
                q=list(kept[:, 1 : 1 + n]),
                setpoints=list(kept[:, 1 + n : 1 + 2 * n]),
                unanswered=unanswered,
                altered=_flipped(last) - _flipped(self._first[name]),
                protest=pendant_message(last["message"]),
                krc_cycle_s=record_cycle_s(self._records[name]),
            )

    def _since(self, robot: str, last: dict[str, Any], counter: str) -> int:
        return int(last["counters"][counter] - self._first[robot]["counters"][counter])

    def _rows(self, robot: str) -> Array:
        return rows_of(self._records[robot], self._from_byte[robot])


def _bring_back(panel: PanelClient) -> None:
    """Recover at the pendant, and wait for the program: if it is restarted too often, it never runs."""
    requests = recovery(panel.ask({"op": "status"})["state"])
    for request in requests:
        panel.ask(request)
    if requests:
        panel.ask({"op": "await", "state": KrcState.RSI_RUNNING, "within_s": _PROGRAM_S})


def _flipped(status: dict[str, Any]) -> int:
    return int(status["faults"]["to_pc"]["counts"]["flipped"])


# Starts a live cell for tests, and ends it.


@contextmanager
def live_cell(folder: Path, cell: str | Path = "lab", robot: str | None = None) -> Iterator[LiveCell]:
    """Start a cell of real processes on free ports; everything is ended after the block.

    Args:
        folder: for its file and records.
        cell: name or file of a cell whose robots are driven over RSI.
        robot: the one under test; None for the first.

    Raises:
        UnknownFaultError: the cell has no such robot, or one without a KRC.
        LaunchError: a process does not come up.
    """
    load_rsi_cell(cell, robot)
    loaded = load_rsi_cell(write_private_cell(folder, cell))
    description = loaded.model.description
    records = {name: folder / f"{name}.csv" for name in loaded.model.robots}
    services = [recorded(service, records) for service in cell_services(description, str(loaded.file))]
    with ExitStack() as stack:
        # Ctrl-C ends the tests, whose end ends the cell
        launcher = stack.enter_context(Launcher(services, lambda *_: None, signals_raise=True))
        panels = {name: stack.enter_context(PanelClient(description, name)) for name in loaded.model.robots}
        launcher.start()
        live = LiveCell(loaded, robot or next(iter(panels)), launcher, panels, records)
        if not live.recover():
            raise CellUseError("the robots did not become ready; is the machine busy with other programs?")
        live.begin()
        stack.callback(live.end_programs)
        yield live


def recorded(service: Service, records: dict[str, Path]) -> Service:
    """The service, an emulated controller with the record that it is to write."""
    if service.role is not Role.EMULATOR or service.robot is None:
        return service
    return with_arguments(service, "--record", str(records[service.robot]))


def with_arguments(service: Service, *arguments: str) -> Service:
    """The service, started with further arguments."""
    return replace(service, arguments=(*service.arguments, *arguments))


class LiveCells:
    """A context manager, which ends the cell that runs.

    Args:
        new_folder: makes a folder for the files of a cell.
    """

    def __init__(self, new_folder: Callable[[], Path]) -> None:
        self._new_folder = new_folder
        self._running = ExitStack()
        self._asked: tuple[str, str | None] | None = None
        self._cell: LiveCell | None = None

    def __enter__(self) -> Self:
        """Enter; no cell is started yet."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the cell that runs."""
        self._running.close()

    def get(self, cell: str, robot: str | None) -> LiveCell:
        """A cell with ready robots, the one under test at home; raises as `live_cell` does."""
        if self._cell is not None and self._asked == (cell, robot) and self._cell.renew():
            return self._cell
        self._running.close()
        self._cell, self._asked = None, None
        self._cell = self._running.enter_context(live_cell(self._new_folder(), cell, robot))
        self._asked = cell, robot
        return self._cell
