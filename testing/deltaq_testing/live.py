"""A cell of real processes on ports of its own for the controller that is tested."""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from deltaq_launch.cell_connection import connect
from deltaq_launch.launcher import Launcher
from deltaq_launch.private_cell import write_private_cell
from deltaq_launch.services import cell_services
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Phase, RobotStatus
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE
from deltaq_testing.deciding import CellUseError
from deltaq_testing.observed import Observed, RobotHistory
from deltaq_testing.schedule import ScheduleError, TimedFault, checked
from deltaq_verification.faults.actions import Freeze, Kill, PressStop
from deltaq_verification.faults.live_cell import MovingCell, Needs, recorded, rows_of
from deltaq_verification.faults.live_inject import Injector
from deltaq_verification.faults.panel import PanelClient, PanelError, pendant_message, recovery
from deltaq_verification.faults.rsi_cell import load_rsi_cell
from deltaq_verification.virtual_cell.loaded_cell import LoadedCell
from deltaq_verification.virtual_cell.parts import Process

CLIENT = "deltaq testing"
_BACK_S = 20.0
"""How long a cell may take to be ready again."""
_POLL_S = 0.02
_HOME_SHARE = 0.1
"""Share of the largest increment with which a robot is brought home."""


class LiveCell(Observed):
    """A cell of real processes, which the controller under test connects to by itself, over zenoh or a socket.

    Questions about it are answered from what the emulated controllers recorded since the test began. Live runs do not
    repeat to the cycle: ask for what holds on a busy machine too.

    Args:
        loaded: the cell; nobody else runs it.
        robot: the one under test.
        launcher: of its processes.
        panels: of each robot's emulated controller.
        records: that each of these keeps.

    Attributes:
        url: where its HLI serves zenoh clients.
        tcp_port: where it serves JSON lines, on 127.0.0.1.
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
        moving = MovingCell(launcher, panels[robot], records, None, None)
        self._injector = Injector(moving, loaded, robot)
        self._waiting: tuple[TimedFault, ...] = ()
        self._standing: list[TimedFault] = []
        self._programs: list[subprocess.Popen[bytes]] = []
        self.begin()

    @property
    def time_s(self) -> float:
        """Time since the test began [s]."""
        return time.monotonic() - self._began_s

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
            folder: that it is started in; None for the one that this program runs in.

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
        """Let faults befall the cell when their time comes; times are counted from the beginning of the test.

        Raises:
            ScheduleError: one cannot be had here, would have had to begin before now, or two change the same part.
        """
        for timed in faults:
            needs = Needs.of(timed.what)
            own = timed.what.action in (Kill(Process.CONTROLLER), Freeze(Process.CONTROLLER))
            if not timed.what.live or own or needs.place or needs.recorder or needs.clocks:
                raise ScheduleError(
                    f"{timed.what.name} cannot befall a live cell under test; take virtual_cell, or a fault of hli, "
                    "sim, robot-server or the KRC"
                )
        checked(faults, self.time_s)
        self._waiting = checked((*self._standing, *self._waiting, *faults))[len(self._standing) :]

    def run(self, duration_s: float) -> None:
        """Wait for so long, while faults befall the cell; then read what was recorded."""
        end_s = self.time_s + duration_s
        while (now_s := self.time_s) < end_s:
            for timed in [one for one in self._standing if one.end_s <= now_s]:
                self._standing.remove(timed)
                self._injector.lift(timed.what)
            while self._waiting and self._waiting[0].at_s <= now_s:
                timed, *rest = self._waiting
                self._waiting = tuple(rest)
                self.fault_rows.append(self._cycle_of(self.robot) - self._first[self.robot]["cycle"])
                self._inject(timed)
                self._standing.append(timed)
            time.sleep(_POLL_S)
        self._read()

    def recover(self) -> bool:
        """Do what an operator does until the robot may move: at the KRC's pendant, then a reset; whether it may."""
        deadline = time.monotonic() + _BACK_S
        while time.monotonic() < deadline:
            with suppress(PanelError, RefusedError, ServiceUnreachableError):
                for name, panel in self._panels.items():
                    for request in recovery(panel.ask({"op": "status"})["state"]):
                        panel.ask(request)
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
        self._waiting = ()
        while self._standing:
            self._injector.lift(self._standing.pop().what)
        if not self.recover():
            return False
        self._go_home()
        self.begin()
        return True

    # --- how it is done -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Begin a test: what is recorded from now on counts."""
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
                robot.send(np.clip(missing, -limits, limits).tolist())

    def _read(self) -> None:
        """Read what the emulated controllers have recorded since the test began, as many cycles of each."""
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
                protest=pendant_message(last["message"]),
            )

    def _since(self, robot: str, last: dict[str, Any], counter: str) -> int:
        return int(last["counters"][counter] - self._first[robot]["counters"][counter])

    def _rows(self, robot: str) -> Array:
        rows = rows_of(self._records[robot])
        since: Array = rows[rows[:, 0] >= self._first[robot]["cycle"]]
        return since


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
        interrupted = signal.getsignal(signal.SIGINT)
        launcher = stack.enter_context(Launcher(services, lambda *_: None))
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, interrupted)  # Ctrl-C ends the tests, whose end ends the cell
        panels = {name: stack.enter_context(PanelClient(description, name)) for name in records}
        launcher.start()
        live = LiveCell(loaded, robot or next(iter(records)), launcher, panels, records)
        if not live.recover():
            raise CellUseError(
                f"the robots are not ready after {_BACK_S:g} s; is the machine busy with other work?"
            )
        live.begin()
        stack.callback(live.end_programs)
        yield live
