"""A cell of real processes on ports of its own, with the floor robot's emulated controller recorded."""

import json
import os
import signal
import socket
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service, cell_services
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Phase
from deltaq_testing.oracle import record_cycle_s
from deltaq_testing.private_cell import write_private_cell

MOVER = Path(__file__).with_name("mover.py")
MOVING_RAD_S = np.deg2rad(25)
TIMEOUT_S = 200.0

PATIENT = "extends: lab\nlease_s: 3.0\n"
"""A holder that waits for a processor of a busy machine is given up less soon than in the cell that is shipped."""


class Stack:
    """What a test can see of it and do to it."""

    def __init__(self, launcher, cell, record, panel):
        self.launcher = launcher
        self.model = cell
        self.cell = cell.description
        self.robot = cell.robots["fr"]
        self.record = record
        self._panel = panel
        self._unanswered_before = 0

    def emulator(self):
        """The emulated controller's panel."""
        driver = self.cell.robots["fr"].driver
        self._panel.sendto(b'{"op":"status"}', (driver.address, driver.control_port))
        return json.loads(self._panel.recv(65536))

    def unanswered(self):
        """How many telegrams of the record got no answer, or a late one."""
        counters = self.emulator()["counters"]
        return counters["missing"] + counters["late"] - self._unanswered_before

    def wait_for(self, reached):
        """Ask the panel until two following answers satisfy `reached(before, after, cycles)`."""
        deadline = time.monotonic() + TIMEOUT_S
        before = self.emulator()
        while time.monotonic() < deadline:
            after = self.emulator()
            cycles = after["cycle"] - before["cycle"]
            if cycles >= 8:
                if reached(np.array(before["q_setpoint"]), np.array(after["q_setpoint"]), cycles):
                    return
                before = after
            self._pause()
        pytest.fail(f"the robot never got there: {self.phase()}")

    def wait_until_said(self, service, text):
        """Until a line of a service, or of what it left behind, has this text: it is read as it comes."""
        deadline = time.monotonic() + TIMEOUT_S
        while not any(text in line for line in list(self.launcher.children[service].lines)):
            assert time.monotonic() < deadline, list(self.launcher.children[service].lines)
            self._pause()

    def wait_cycles(self, count):
        """Until the controller has gone through so many cycles."""
        end = self.emulator()["cycle"] + count
        while self.emulator()["cycle"] < end:
            self._pause()

    def _pause(self):
        """Leave the emulator its core: whoever asks without a pause takes what the cell needs to get on."""
        time.sleep(self.cell.cycle_s)

    def setpoint(self):
        """What the drives are sent now, (n,) [rad or m]."""
        return np.array(self.emulator()["q_setpoint"])

    def wait_until_moving(self):
        bound = MOVING_RAD_S * self.cell.cycle_s
        self.wait_for(lambda before, after, cycles: np.max(np.abs(after - before)) > bound * cycles)

    def wait_until_at_rest(self):
        self.wait_for(lambda before, after, cycles: (before == after).all())

    def ask(self, **request):
        """Ask the emulated controller's panel, and be told that it did it."""
        driver = self.cell.robots["fr"].driver
        self._panel.sendto(json.dumps(request).encode(), (driver.address, driver.control_port))
        answer = json.loads(self._panel.recv(65536))
        assert answer["ok"], answer
        return answer

    def kill(self, name):
        """`kill -9`, and the cycle of the robot in which it was sent; returns when the launcher knows of the end."""
        cycle = self.emulator()["cycle"]
        child = self.launcher.children[name]
        os.killpg(child.pid, signal.SIGKILL)
        child.exited.wait()
        return cycle

    def phase(self):
        with connect(self.cell, "test") as running:
            status = running.status().robots["fr"]
        return status.phase, status.reason

    def reset(self):
        """Reset until it is granted: a service that has just come back may need a moment to be heard."""
        deadline = time.monotonic() + TIMEOUT_S
        with connect(self.cell, "test") as running:
            while True:
                try:
                    running.reset("fr")
                    return
                except RefusedError:
                    assert time.monotonic() < deadline
                self._pause()

    def wait_for_reason(self, reason):
        deadline = time.monotonic() + TIMEOUT_S
        with connect(self.cell, "test") as running:
            while (
                status := running.status().robots["fr"]
            ).reason != reason or status.phase is not Phase.HELD:
                assert time.monotonic() < deadline, (status.phase, status.reason)
                self._pause()

    @property
    def krc_cycle_s(self):
        """The emulated controller's cycle by its own record, in which its setpoints are judged [s]."""
        return record_cycle_s(self.record)

    def setpoints(self):
        joints = self.robot.n
        columns = (0, *range(2 + joints, 2 + 2 * joints))
        rows = np.loadtxt(self.record, delimiter=",", skiprows=1, usecols=columns)
        return rows[:, 0].astype(int), rows[:, 1:]


def mover(cell):
    """The controller that swings A1 of the floor robot for ever."""
    return Service("mover", Role.LEADER, (str(MOVER), str(cell.tcp_port)), needs=("hli",))


@contextmanager
def live_stack(
    folder,
    *,
    moving=False,
    base=None,
    encrypted_at=None,
    rewired=lambda services, file: services,
):
    """Start a cell; `moving` adds a controller that swings A1 of the floor robot for ever.

    HLI, SIM and Robot Servers meet at Unix sockets, or over TLS at the address `encrypted_at`. `base` is a patient lab
    if none is given. `rewired` may change the services before they start; it is given the cell's file too.
    """
    if base is None:
        base = folder / "patient.yaml"
        base.write_text(PATIENT)
    file = write_private_cell(folder, base, encrypted_at)
    cell = CellModel.load(file)
    record = folder / "fr.csv"
    services = [
        replace(service, arguments=(*service.arguments, "--record", str(record)))
        if service.role is Role.EMULATOR and service.robot == "fr"
        else service
        for service in cell_services(cell.description, str(file))
    ]
    services = [*rewired(services, file), *([mover(cell.description)] if moving else [])]
    with Launcher(services, lambda name, line: print(name, line, file=sys.stderr)) as launcher:
        launcher.start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as panel:
            panel.settimeout(300)
            stack = Stack(launcher, cell, record, panel)
            if moving:
                stack.wait_until_moving()
            yield stack
