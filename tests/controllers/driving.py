"""A robot driven by hand in plain kinematics, and through the whole stack in virtual time."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.driving import DrivingMode, Frame, OperatorCommand
from deltaq_protocol.messages import Verdict
from deltaq_testing.virtual_cell.cell import VirtualCell

CYCLE_S = 0.012


@cache
def model(robot: str) -> RobotModel:
    return CellModel.load("dawm" if robot == "dawm" else "lab").robots[robot]


@dataclass
class Driven:
    """What was commanded and measured since the beginning."""

    robot: RobotModel
    q_cmd: list[Array] = field(default_factory=list)
    q: list[Array] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    limitations: list[str] = field(default_factory=list)
    others_verdicts: list[Verdict] = field(default_factory=list)

    def hand_errors(self, of: list[Array], start: Array) -> tuple[float, float]:
        """How far any hand was off from where it is at `start` [m, rad]."""
        hands = Hands(self.robot)
        hands.update(start)
        kept = hands.rotations, hands.positions
        worst = np.zeros(2)
        for q in of:
            hands.update(q)
            error = np.linalg.norm(hands.error(*kept).reshape(-1, 2, 3), axis=2).max(axis=0)
            worst = np.maximum(worst, error)
        return float(worst[0]), float(worst[1])


class PlainDrive:
    """Whatever is asked for is done."""

    def __init__(
        self, robot: str, mode: DrivingMode, q: Array | None = None, frame: Frame = Frame.WORLD
    ) -> None:
        self.robot = model(robot)
        self.teleoperator = Teleoperator(self.robot, CYCLE_S, mode, frame)
        self.now = (self.robot.home if q is None else q).copy()
        self.cycle = 0
        self.driven = Driven(self.robot)
        self.dq_last = np.zeros(self.robot.n)
        self.violations = 0

    def drive(self, duration_s: float, mode: DrivingMode | None = None, **rates: float) -> Driven:
        """Hold a command for a time; returns what happened meanwhile."""
        self.driven = Driven(self.robot)
        for _ in range(round(duration_s / CYCLE_S)):
            self.step(OperatorCommand(rates, mode))
        return self.driven

    def step_scaled(self, share: float, **rates: float) -> None:
        """Hold a command for a cycle of which a gate admits a share, between the brake and what is asked for."""
        last = self.dq_last.copy()
        self.step(OperatorCommand(rates))
        brake = last * (1.0 - 1.0 / brake_cycles(last, self.teleoperator.limits.max_ddq))
        admitted = brake + share * (self.dq_last - brake)
        self.now = self.now - self.dq_last + admitted
        self.dq_last = admitted

    def step(self, command: OperatorCommand) -> Array:
        self.cycle += 1
        self.teleoperator.command = command
        dq = self.teleoperator.increment(
            View(RobotView(self.cycle, self.cycle * CYCLE_S, self.now, self.now))
        )
        limits = self.robot
        change = np.abs(dq - self.dq_last) > limits.max_acceleration * CYCLE_S**2 * (1 + 1e-6)
        speed = np.abs(dq) > limits.max_velocity * CYCLE_S * (1 + 1e-6)
        self.now = self.now + dq
        outside = (self.now > limits.upper) | (self.now < limits.lower)
        self.violations += int((change | speed | outside).sum())
        self.dq_last = dq
        self.driven.q_cmd.append(self.now)
        limitation = self.teleoperator.limitation
        self.driven.limitations.append(limitation.limit.value if limitation else "")
        return dq

    def rest(self) -> None:
        """Let go until the robot stands, and a little longer."""
        self.drive(1.5)


class StackDrive:
    """The same through emulated controller, Robot Server, gate and HLI, in virtual time."""

    def __init__(
        self, robot: str, mode: DrivingMode, q: Array | None = None, keeps_clear: bool = False
    ) -> None:
        cell = "dawm" if robot == "dawm" else "lab"
        self.name = robot
        self.stack = VirtualCell(cell, {} if q is None else {robot: q})
        self.robot = self.stack.cell.robots[robot]
        self.stack.run_until_ready()
        self.stack.acquire(robot, "test")
        around = RobotSurroundings(self.stack.cell, robot) if keeps_clear else None
        self.teleoperator = Teleoperator(self.robot, CYCLE_S, mode, surroundings=around)
        self._others: dict[str, Teleoperator] = {}

    def join(self, robot: str, mode: DrivingMode, **rates: float) -> None:
        """Have another robot of the cell driven too, from now on."""
        if robot not in self._others:
            self.stack.acquire(robot, "other")
            self._others[robot] = Teleoperator(self.stack.cell.robots[robot], CYCLE_S, mode)
        self._others[robot].command = OperatorCommand(rates, mode)

    def drive(
        self, duration_s: float, mode: DrivingMode | None = None, option: int | None = None, **rates: float
    ) -> Driven:
        """Hold a command for a time; returns what happened meanwhile."""
        driven = Driven(self.robot)
        self.teleoperator.command = OperatorCommand(rates, mode, option=option)
        for _ in range(round(duration_s / CYCLE_S)):
            self.stack.cycle()
            state = self.stack.states[self.name]
            views = {name: RobotView.from_state(one) for name, one in self.stack.states.items()}
            increment = self.teleoperator.increment(View(views.pop(self.name), views))
            verdict = self.stack.ask(self.name, increment)
            assert verdict is not None
            self.teleoperator.take_verdict(verdict)
            for name, other in self._others.items():
                own = RobotView.from_state(self.stack.states[name])
                verdict_on_other = self.stack.ask(name, other.increment(View(own)))
                assert verdict_on_other is not None
                other.take_verdict(verdict_on_other)
                driven.others_verdicts.append(verdict_on_other)
            driven.q_cmd.append(np.array(state.q_cmd))
            driven.q.append(np.array(state.q))
            driven.verdicts.append(verdict)
            limitation = self.teleoperator.limitation
            driven.limitations.append(limitation.limit.value if limitation else "")
        return driven
