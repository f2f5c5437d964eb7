"""Injects every fault of the catalogue that real processes can suffer, those of relays, clocks and disks too."""

import json
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Never

import zenoh

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.services import Role
from deltaq_protocol import topics
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import PROTOCOL_VERSION
from deltaq_protocol.session import open_session
from deltaq_testing.faults.catalogue import (
    BeginInThePast,
    Fault,
    FillDisk,
    Impair,
    ImpairStream,
    Kill,
    ReadNothing,
    SetWallClock,
    StepClock,
)
from deltaq_testing.live import Injector
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Process
from studies.live_faults.clocks import Clocks, SettableClocks
from studies.live_faults.moving_cell import MovingCell

# Clients that ask for everything and read nothing: `python -m studies.live_faults.injector CELL`.
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


class EveryFaultInjector(Injector):
    """Injects faults into a running cell.

    Args:
        running: the cell.
        loaded: the same, as it was read.
        robot: the one that moves.
    """

    def __init__(self, running: MovingCell, loaded: LoadedCell, robot: str) -> None:
        super().__init__(running.launcher, running.panel, loaded.model.description, robot)
        self._running, self._file = running, loaded.file
        self._reader: subprocess.Popen[str] | None = None

    def prepare(self, fault: Fault) -> None:
        """Do beforehand what takes a while: buffers of a client that reads nothing have to run full."""
        if not isinstance(fault.action, ReadNothing):
            return
        command = [sys.executable, "-m", "studies.live_faults.injector", str(self._file)]
        self._reader = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._reader.stdout is not None  # a pipe was asked for
        self._reader.stdout.readline()  # it hangs there now
        deadline = time.monotonic() + _FULL_S
        with connect(self.cell, "deltaq fault") as running:
            while not running.status().hli.get("tcp_states_skipped"):
                if self._reader.poll() is not None or time.monotonic() > deadline:
                    raise DeltaqError("no client could be made to hang there without reading")

    def inject(self, fault: Fault) -> None:
        """Let the fault begin."""
        match fault.action:
            case BeginInThePast(process, _):
                self.signal(process, signal.SIGKILL)
            case StepClock(process, by_s):
                self._clocks.set(self.pid(process), Clocks(monotonic_s=by_s))
            case SetWallClock(by_s, drift_ppm):
                self._set_wall_clocks(Clocks(wall_s=by_s, wall_drift_ppm=drift_ppm))
            case Impair(_, faults) | ImpairStream(_, faults):
                assert self._running.relay is not None  # `RelayPlacement.of` says where one has to stand
                self._running.relay.impair(faults)
            case FillDisk():
                full = (_FULL_BYTES, _FULL_BYTES)
                resource.prlimit(self.pid(Process.RECORDER), resource.RLIMIT_FSIZE, full)
            case _:
                super().inject(fault)

    def lift(self, fault: Fault) -> list[str]:
        """Let it end; tells what had to be done for that."""
        match fault.action:
            case Kill(Process.RECORDER):
                return []  # nobody needs it
            case BeginInThePast(process, by_s):
                self._clocks.begin_with(Clocks(wall_s=by_s))
                return self.restart(process)
            case SetWallClock():
                self._set_wall_clocks(Clocks())
            case Impair() | ImpairStream():
                assert self._running.relay is not None  # it was impaired
                self._running.relay.lift()
            case ReadNothing():
                assert self._reader is not None  # it was started
                self._reader.kill()
                self._reader.communicate()
        return super().lift(fault)

    @property
    def _clocks(self) -> SettableClocks:
        assert self._running.clocks is not None  # `Needs.of` says when
        return self._running.clocks

    def _set_wall_clocks(self, clocks: Clocks) -> None:
        """Set those of every service; the emulated controllers are machines of their own."""
        launcher = self.launcher
        for service in launcher.services:
            if service.role is not Role.EMULATOR:
                self._clocks.set(launcher.children[service.name].pid, clocks)
