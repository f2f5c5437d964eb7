"""The gate with real Robot Servers' cores behind it, and what it says, message by message."""

import math

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.guarded import Admission, Command, CommandReply, Request, Supervision
from deltaq_protocol.messages import Verdict
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.sim.core import Sim

CELL = CellModel.load("lab")
REST_CYCLES = math.ceil(CELL.description.gate.servo_lag_s / CELL.description.cycle_s) + 4
"""Cycles until a robot that brakes from small increments is at rest for all that the gate knows."""

SMALL = (1e-5, 0.0, 0.0, 0.0, 0.0, 0.0)


def bound(sim, **fields):
    """A command as the HLI binds it: to this gate, after all before, and to the robots' newest states."""
    states = {name: robot.tracker.state for name, robot in sim.robots.items()}
    cycles = {name: state.cycle for name, state in states.items() if state is not None}
    return Command(**{"id": sim.snapshot().command_id + 1, "epoch": sim.epoch, "cycles": cycles} | fields)


class Rig:
    """Two robots that are always where they were sent, their servers, and the gate."""

    def __init__(self, cell=CELL, **start):
        self.sim = Sim(cell, epoch=5)
        self.servers = {name: RobotServer(cell.description, name, process=1) for name in cell.robots}
        self.q = {name: robot.home.copy() for name, robot in cell.robots.items()} | start
        self.mail = dict.fromkeys(CELL.robots, (None, None))
        self.time_s = 0.0
        self.seq = 0
        self.said = []
        for _ in range(10):
            self.cycle()
        for _ in range(70):  # their modes are found out
            self.cycle()
        assert not any(server.detail for server in self.servers.values())

    def cycle(self, offset=0.0):
        """One cycle; FR is measured `offset` rad away from where it is."""
        self.time_s += 0.012
        self.said = []
        for name, server in self.servers.items():
            start = self.q[name] if server.state is None else None
            q = self.q[name] + (offset if name == "fr" else 0.0)
            measured = Measurement(round(self.time_s * 1000), q, start)
            admission, supervision = self.mail[name]
            self.mail[name] = (None, None)
            for message in (admission, supervision):
                if message is not None:
                    server.take(message, self.time_s)
            (setpoint,) = server.take(measured, self.time_s)
            self.q[name] = setpoint.q_cmd
            self.deliver(self.sim.take(server.state))

    def restart_server(self, robot):
        """Its process dies, and another takes its place."""
        process = self.servers[robot].process + 1
        self.servers[robot] = RobotServer(CELL.description, robot, process)

    def deliver(self, outputs):
        for output in outputs:
            self.said.append(output.message)
            admission, supervision = self.mail.get(output.robot, (None, None))
            if isinstance(output.message, Admission):
                self.mail[output.robot] = (output.message, supervision)
            elif isinstance(output.message, Supervision):
                self.mail[output.robot] = (admission, output.message)

    def request(self, dq=SMALL, cycle=None, seq=None, lease_epoch=1, robot="fr"):
        """Ask, and return what the gate said of it."""
        self.seq = seq if seq is not None else self.seq + 1
        cycle = self.state.cycle if cycle is None else cycle
        self.said = []
        self.deliver(
            self.sim.take(Request(robot=robot, cycle=cycle, lease_epoch=lease_epoch, seq=self.seq, dq=dq))
        )
        return self.verdict()

    def verdict(self):
        verdicts = [message for message in self.said if isinstance(message, Verdict)]
        return verdicts[-1] if verdicts else None

    def command(self, **fields):
        self.said = []
        self.deliver(self.sim.take(bound(self.sim, **fields)))
        return self.reply()

    def reply(self):
        replies = [message for message in self.said if isinstance(message, CommandReply)]
        return replies[-1] if replies else None

    def alive(self, lease_epoch=1, cycle=None):
        """A heartbeat of the HLI, and what the gate said upon it."""
        cycle = self.state.cycle if cycle is None else cycle
        self.said = []
        self.deliver(self.sim.take(Request(robot="fr", cycle=cycle, lease_epoch=lease_epoch)))
        return self.verdict()

    @property
    def state(self):
        return self.servers["fr"].state
