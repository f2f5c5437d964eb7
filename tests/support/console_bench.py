"""The console's core with a clock that is turned by hand, and browsers that it talks to."""

import json

from deltaq_cell.load import load_cell
from deltaq_protocol import driving
from deltaq_protocol.messages import Outcome, Phase, RobotState, ToolPose, Verdict
from deltaq_services.console.core import ConsoleCore
from deltaq_services.console.messages import Ack, ConsoleEvent, ConsoleStatus
from deltaq_services.console.outputs import AskHli, ToClient, ToDriver

CELL = load_cell("lab")
BODIES = ("fr/link_5", "gr/link_3", "structure/tank_1")
POSE = ToolPose(position=(0.1, 0.2, 0.3), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))


class ConsoleBench:
    """A core, and what it wants done."""

    def __init__(self, token_needed=False, cell=CELL):
        self.now_s = 1000.0
        self.cell = cell
        self.core = ConsoleCore(cell, BODIES, token_needed)
        self.outputs = []
        self._cycle = 0

    def browser(self, name="desk", operator=True):
        client, outputs = self.core.connect(name, operator, self.now_s)
        return Browser(self, client, outputs)

    def done(self, outputs):
        self.outputs += outputs
        return outputs

    def tick(self, seconds=0.0):
        self.now_s += seconds
        return self.done(self.core.tick(self.now_s))

    def asked(self, kind):
        return [output for output in self.outputs if isinstance(output, AskHli) and output.kind == kind]

    def driver_requests(self, robot="fr"):
        return [
            output.request
            for output in self.outputs
            if isinstance(output, ToDriver) and output.robot == robot
        ]

    def driver_answers(self, robot="fr", done=True, text=""):
        """The driver answers the newest request that has an id."""
        request = [each for each in self.driver_requests(robot) if each.id is not None][-1]
        answer = driving.DriverAnswer(id=request.id, done=done, text=text)
        return self.done(self.core.driver_said(robot, answer, self.now_s))

    def state(self, phase=Phase.READY, reason=None, moved=0.0, robot="fr", tool=POSE, **fields):
        """A state comes, whose first joint has moved on by so much [rad]."""
        self._cycle += 1
        home = self.cell.robots[robot].home
        q = (home[0] + moved, *home[1:])
        state = RobotState(
            robot=robot, cycle=self._cycle, ipoc=self._cycle, time_s=self.now_s, q=q, q_cmd=q, tool=tool,
            phase=phase, reason=reason, **fields,
        )  # fmt: skip
        self.core.picture.take_state(state, self.now_s)

    def states(self, phase=Phase.READY, reason=None):
        """Both robots stand, as two following states say."""
        for _ in range(2):
            for robot in self.cell.robots:
                self.state(phase, reason, robot=robot)

    def verdict(self, outcome=Outcome.ADMITTED, reasons=(), robot="fr", **fields):
        verdict = Verdict(robot=robot, cycle=self._cycle, seq=1, outcome=outcome, reasons=reasons, **fields)
        self.core.picture.take_verdict(verdict, self.now_s)


class Browser:
    """A browser, its clock off by `ahead_s`."""

    def __init__(self, bench, client, outputs):
        self.bench, self.client, self.ahead_s = bench, client, 0.0
        self.got = []
        self._ids = 0
        self._keep(outputs)

    def raw(self, message):
        outputs = self.bench.done(self.bench.core.take(self.client, message, self.bench.now_s))
        self._keep(outputs)
        return outputs

    def send(self, kind, late_s=0.0, **fields):
        """Send a command that has been on its way for `late_s`; returns the acknowledgement."""
        self._ids += 1
        fields = {
            "id": f"c{self._ids}",
            "sent_ms": 1000.0 * (self.bench.now_s + self.ahead_s - late_s),
            **fields,
        }
        self.raw(json.dumps({"type": kind, **fields}))
        return self.got[-1]

    def takes(self, robot="fr"):
        """Take the robot's lease, which the driver gets."""
        self.send("lease", robot=robot, action="take")
        self._keep(self.bench.driver_answers(robot))

    def hears(self, outputs):
        self._keep(outputs)
        return self.got

    def status(self, seconds=0.0):
        self._keep(self.bench.tick(seconds))
        return [message for message in self.got if isinstance(message, ConsoleStatus)][-1]

    def acks(self, command_id):
        return [message for message in self.got if isinstance(message, Ack) and message.id == command_id]

    def events(self, kind):
        return [
            message.text for message in self.got if isinstance(message, ConsoleEvent) and message.kind == kind
        ]

    def _keep(self, outputs):
        self.got += [
            output.message
            for output in outputs
            if isinstance(output, ToClient) and output.client == self.client.number
        ]
