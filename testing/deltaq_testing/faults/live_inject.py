"""What makes real processes suffer a fault, and what ends it."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Never

import zenoh

from deltaq_cell.description import RsiDescription
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.services import Role
from deltaq_protocol import topics
from deltaq_protocol.messages import PROTOCOL_VERSION
from deltaq_protocol.session import open_session
from deltaq_testing.faults.bombard import Bomber
from deltaq_testing.faults.catalogue import (
    CHANGE_S,
    AskPanel,
    BeginInThePast,
    Bombard,
    Fault,
    FillDisk,
    Freeze,
    Impair,
    ImpairStream,
    Kill,
    ReadNothing,
    SetWallClock,
    StepClock,
)
from deltaq_testing.faults.clocks import Clocks, SettableClocks
from deltaq_testing.faults.live_cell import MovingCell
from deltaq_testing.faults.virtual import FaultRunError
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Process

# Clients that ask for everything and read nothing: `python -m deltaq_testing.faults.live_inject
# CELL`.
#
# Several hang on the TCP port with full buffers, and a zenoh session stays alive while its reading stands
# still.

_TCP_CLIENTS = 8


def main() -> None:
    """Hang there until killed."""
    cell = load_cell(sys.argv[1])
    hello = {"type": "hello", "protocol": PROTOCOL_VERSION, "client": "who reads nothing"}
    hanging = []
    for _ in range(_TCP_CLIENTS):
        client = socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # before it connects: full at once
        client.connect((cell.tcp_address, cell.tcp_port))
        client.sendall(json.dumps(hello).encode() + b"\n")
        hanging.append(client)
    session = open_session(connect=[cell.hli], must_connect=True)
    stands_still = threading.Event()

    def never_return(_: zenoh.Sample) -> Never:
        stands_still.set()
        while True:
            threading.Event().wait()

    callback = zenoh.handlers.Callback(never_return, indirect=False)  # in the thread that reads the socket
    session.declare_subscriber(topics.STATE.key(cell.cell), callback)
    stands_still.wait()
    print("ready: reads nothing", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()


_FULL_BYTES = 4096
"""No file of the recorder may be longer than this once its disk is full."""
_FULL_S = 30.0
"""How long buffers may take to run full."""


class Injector:
    """Injects faults into a running cell.

    Args:
        running: the cell.
        loaded: the same, as it was read.
        robot: the one that moves.
    """

    def __init__(self, running: MovingCell, loaded: LoadedCell, robot: str) -> None:
        self._running, self._loaded, self._robot = running, loaded, robot
        self._reader: subprocess.Popen[str] | None = None
        self._bomber: Bomber | None = None

    def prepare(self, fault: Fault) -> None:
        """Do beforehand what takes a while: buffers of a client that reads nothing have to run full."""
        if not isinstance(fault.action, ReadNothing):
            return
        cell = self._loaded.model.description
        command = [sys.executable, "-m", "deltaq_testing.faults.live_inject", str(self._loaded.file)]
        self._reader = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._reader.stdout is not None  # a pipe was asked for
        self._reader.stdout.readline()  # it hangs there now
        deadline = time.monotonic() + _FULL_S
        with connect(cell, "deltaq fault") as running:
            while not running.status().hli.get("tcp_states_skipped"):
                if self._reader.poll() is not None or time.monotonic() > deadline:
                    raise FaultRunError("no client could be made to hang there without reading")

    def inject(self, fault: Fault) -> None:
        """Let the fault begin."""
        match fault.action:
            case Kill(process) | BeginInThePast(process, _):
                self._signal(process, signal.SIGKILL)
            case Freeze(process):
                self._signal(process, signal.SIGSTOP)
            case StepClock(process, by_s):
                self._clocks.set(self._pid(process), Clocks(monotonic_s=by_s))
            case SetWallClock(by_s, drift_ppm):
                self._set_wall_clocks(Clocks(wall_s=by_s, wall_drift_ppm=drift_ppm))
            case AskPanel(request):
                self._running.panel.ask(request)
            case Impair(_, faults) | ImpairStream(_, faults):
                assert self._running.relay is not None  # `Place.of` says where one has to stand
                self._running.relay.impair(faults)
            case Bombard():
                driver = self._loaded.model.description.robots[self._robot].driver
                assert isinstance(driver, RsiDescription)  # `load_rsi_cell` has seen to that
                self._bomber = Bomber(fault.action, (driver.address, driver.port))
                self._bomber.__enter__()
            case FillDisk():
                full = (_FULL_BYTES, _FULL_BYTES)
                resource.prlimit(self._pid(Process.RECORDER), resource.RLIMIT_FSIZE, full)

    def lift(self, fault: Fault) -> list[str]:
        """Let it end; tells what had to be done for that."""
        if fault.changes_program:
            self._running.panel.ask({"op": "stop"})
            time.sleep(CHANGE_S)
        if fault.lift is not None:
            self._running.panel.ask(fault.lift)
        match fault.action:
            case Kill(Process.RECORDER):
                return []  # nobody needs it
            case Kill(process):
                self._running.launcher.restart(self._service(process))
                return [f"restart of the {process}"]
            case BeginInThePast(process, by_s):
                self._clocks.begin_with(Clocks(wall_s=by_s))
                self._running.launcher.restart(self._service(process))
                return [f"restart of the {process}"]
            case Freeze(process):
                self._signal(process, signal.SIGCONT)
            case SetWallClock():
                self._set_wall_clocks(Clocks())
            case Impair() | ImpairStream():
                assert self._running.relay is not None  # it was impaired
                self._running.relay.lift()
            case Bombard():
                assert self._bomber is not None  # it was started
                self._bomber.__exit__()
            case ReadNothing():
                assert self._reader is not None  # it was started
                self._reader.kill()
                self._reader.communicate()
        return []

    @property
    def _clocks(self) -> SettableClocks:
        assert self._running.clocks is not None  # `Needs.of` says when
        return self._running.clocks

    def _set_wall_clocks(self, clocks: Clocks) -> None:
        """Set those of every service; the emulated controllers are machines of their own."""
        launcher = self._running.launcher
        for service in launcher.services:
            if service.role is not Role.EMULATOR:
                self._clocks.set(launcher.children[service.name].pid, clocks)

    def _service(self, process: Process) -> str:
        return f"{process}-{self._robot}" if process is Process.ROBOT_SERVER else str(process)

    def _pid(self, process: Process) -> int:
        return self._running.launcher.children[self._service(process)].pid

    def _signal(self, process: Process, number: signal.Signals) -> None:
        os.killpg(self._pid(process), number)
