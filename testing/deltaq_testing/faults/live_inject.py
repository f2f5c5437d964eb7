"""Injects faults into the processes of a live cell, and ends them."""

import os
import signal
import time

from deltaq_cell.description import RsiDescription
from deltaq_cell.description.cell import CellDescription
from deltaq_deploy.launch.launcher import Launcher
from deltaq_testing.faults.bombard import Bomber
from deltaq_testing.faults.catalogue import CHANGE_S, AskPanel, Bombard, Fault, Freeze, Kill, PressStop
from deltaq_testing.faults.panel import PanelClient
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
