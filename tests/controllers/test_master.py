"""`deltaq drive --master`: another robot's tool leads a hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from driving import CYCLE_S, PlainDrive, StackDrive, model
from pages import steps

from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput, led_hand
from deltaq_controllers.operator_input.master import (
    JUMP_M,
    MOST_M_S,
    REST_S,
    SLACK_M,
    STALE_S,
    LedInput,
    LedPose,
    Master,
    PlacedTool,
)
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode, Frame, Grip, OperatorCommand
from deltaq_protocol.messages import Outcome
from deltaq_testing.virtual_cell.cell import VirtualCell

GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "lead-by-another-robot.md"


class Clutch(OperatorInput):
    """A device on which an operator holds a button, or not."""

    status = "a button"

    def __init__(self) -> None:
        self.hand: str | None = None
        self.is_clutched = True
        self.command: OperatorCommand | None = OperatorCommand()
        self.felt: list[float] = []

    def reflect(self, share: float) -> None:
        self.felt.append(share)

    def read(self, time_s: float) -> OperatorCommand | None:
        return self.command and replace(self.command, led=led_hand(self.hand) if self.is_clutched else None)

    def __enter__(self) -> Clutch:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""


class Led:
    """`gr` led by `fr`, which somebody else drives, both in plain kinematics."""

    def __init__(
        self, scale: float = 0.5, frame: Frame = Frame.WORLD, robot: str = "gr", master: str = "fr"
    ) -> None:
        self.slave = PlainDrive(robot, DrivingMode.COUPLED, frame=frame)
        self.leader = PlainDrive(master, DrivingMode.COUPLED)
        self.clutch = Clutch()
        self.is_seen = True
        self._cycle = 0
        master = Master(self.slave.teleoperator, self.leader.robot, self._look, scale)
        self.input = LedInput(self.clutch, master)
        self.time_s = 0.0
        self.rest()

    def rest(self) -> None:
        """The master stands, uncoupled, until it counts; then it is coupled."""
        self.clutch.is_clutched = False
        self.drive(REST_S + 2 * CYCLE_S)
        self.clutch.is_clutched = True

    def _look(self) -> tuple[RobotView | None, RobotView | None]:
        self._cycle += self.is_seen
        return (
            RobotView(self._cycle, self._cycle * CYCLE_S, self.leader.now, self.leader.now),
            RobotView(1, self.time_s, self.slave.now, self.slave.now),
        )

    def drive(self, duration_s: float, **rates: float) -> OperatorCommand:
        """The master is driven by somebody; returns the last command."""
        command = OperatorCommand()
        for _ in range(round(duration_s / CYCLE_S)):
            self.leader.step(OperatorCommand(rates))
            command = self.read()
            self.slave.step(command)
        return command

    def read(self) -> OperatorCommand:
        self.time_s += CYCLE_S
        command = self.input.read(self.time_s)
        assert command is not None
        return command

    def poses(self) -> tuple[PlacedTool, PlacedTool]:
        found = []
        for run in (self.leader, self.slave):
            hands = Hands(run.robot)
            hands.place(run.now)
            found.append(PlacedTool(hands.rotations[0], hands.positions[0]))
        return found[0], found[1]


@pytest.fixture
def led() -> Led:
    return Led()


# --- what must not move ---------------------------------------------------------------------------------------


def test_a_robot_cannot_lead_itself() -> None:
    operator = Teleoperator(model("gr"), CYCLE_S, DrivingMode.COUPLED)
    with pytest.raises(ControllerError, match="master gr: a robot cannot lead itself"):
        Master(operator, model("gr"), lambda: (None, None), 1.0)


def test_an_uncoupled_or_silent_master_moves_nothing(led: Led) -> None:
    led.clutch.is_clutched = False
    assert led.drive(0.5, x=0.1) == OperatorCommand()
    assert "fr is not coupled" in led.input.status
    unseen = LedInput(Clutch(), Master(led.slave.teleoperator, model("fr"), lambda: (None, None), 1.0))
    assert unseen.read(0.0) == OperatorCommand(led="")
    assert "sends no state" in unseen.status


def test_the_executed_fraction_is_felt_at_the_coupling_device(led: Led) -> None:
    led.input.reflect(0.25)
    assert led.clutch.felt == [0.25]


def test_a_silent_master_means_rest_until_it_is_coupled_again(led: Led) -> None:
    assert led.drive(0.5, x=0.1).rates["x"] > 0.03
    led.is_seen = False
    led.drive(STALE_S + 0.1, x=0.1)
    assert led.read().rates == {}
    assert "sends no state: couple it again" in led.input.status
    led.is_seen = True
    assert led.drive(0.3, x=0.1).rates == {}, "what it did meanwhile is not made up"
    led.rest()
    assert led.drive(0.5, x=0.1).rates["x"] > 0.03


def test_a_master_in_motion_leads_nothing_until_it_was_at_rest(led: Led) -> None:
    led.input = LedInput(led.clutch, Master(led.slave.teleoperator, led.leader.robot, led._look, 1.0))
    for is_clutched in (False, True, False, True):
        led.clutch.is_clutched = is_clutched
        assert led.drive(0.5, x=0.1).rates == {}
    assert "fr moves: let it rest, then couple it" in led.input.status
    led.drive(1.0)
    assert led.drive(0.5, x=0.1) == OperatorCommand(led=""), "it was coupled while it moved"
    led.rest()
    assert led.drive(0.5, x=0.1).rates["x"] > 0.03


def test_a_master_that_jumps_is_uncoupled(led: Led) -> None:
    led.drive(0.3, x=0.1)
    led.leader.now = led.leader.now + 0.5
    assert led.read().rates == {}
    assert "jumped: couple it again" in led.input.status


def test_a_mode_without_hands_is_not_led(led: Led) -> None:
    led.slave = PlainDrive("gr", DrivingMode.JOINT)
    led.input = LedInput(led.clutch, Master(led.slave.teleoperator, led.leader.robot, led._look, 1.0))
    assert led.drive(0.2, x=0.1) == OperatorCommand(led="")
    assert "leads no hand in mode joint" in led.input.status


def test_only_the_device_ends_the_drive(led: Led) -> None:
    led.clutch.command = None
    assert led.input.read(0.0) is None


# --- what moves -----------------------------------------------------------------------------------------------


def test_the_hand_makes_the_scaled_displacement_and_the_rotation_of_the_master() -> None:
    led = Led(scale=0.5)
    led.drive(0.05)
    master, hand = led.poses()
    led.drive(1.0, x=0.1, rz=0.2)
    led.drive(1.0, y=0.1)
    led.drive(1.5)
    master_now, hand_now = led.poses()
    way = master_now.position - master.position
    assert np.linalg.norm(way) > 0.1
    assert hand_now.position - hand.position == pytest.approx(0.5 * way, abs=1e-3)
    turn = pin.log3(master_now.rotation @ master.rotation.T)
    assert np.linalg.norm(turn) > 0.1
    assert pin.log3(hand_now.rotation @ hand.rotation.T) == pytest.approx(turn, abs=2e-3)
    assert led.slave.violations == 0


def test_the_hand_stays_while_an_uncoupled_master_is_brought_back() -> None:
    led = Led(scale=1.0)
    led.drive(1.0, x=0.1)
    led.clutch.is_clutched = False
    led.drive(0.5)
    before = led.poses()[1].position
    led.drive(1.0, x=-0.1)
    assert led.poses()[1].position == pytest.approx(before, abs=1e-6)
    led.clutch.is_clutched = True
    led.drive(1.0, x=0.05)
    led.drive(0.5)
    assert led.poses()[1].position[0] - before[0] > 0.03


def test_in_tool_axes_forward_motion_of_the_master_is_forward_motion_of_the_hand() -> None:
    led = Led(scale=1.0, frame=Frame.TOOL)
    led.leader.teleoperator.frame = Frame.TOOL
    led.drive(0.05)
    start = led.poses()
    led.drive(0.8, z=-0.1)
    led.drive(0.8)
    ways = [
        now.rotation.T @ (now.position - then.position) for now, then in zip(led.poses(), start, strict=True)
    ]
    assert ways[0][2] < -0.05
    assert ways[1] == pytest.approx(ways[0], abs=2e-3)


def random_pose(random: np.random.Generator) -> PlacedTool:
    return PlacedTool(pin.exp3(random.uniform(-1.0, 1.0, 3)), random.uniform(-1.0, 1.0, 3))


def test_a_hand_that_could_not_follow_reverses_at_once_with_the_master(
    random: np.random.Generator,
) -> None:
    for _ in range(10):
        master, hand = random_pose(random), random_pose(random)
        led = LedPose(1.0)
        led.couple(master, hand, own_axes=False)
        way, time_s = np.array([0.005, 0.0, 0.0]), 0.0
        for step in range(1, 101):
            time_s += CYCLE_S
            twist = led.twist(time_s, PlacedTool(master.rotation, master.position + step * way), hand)
        assert twist is not None
        assert twist[0] > 0.4
        for step in range(100, 80, -1):
            time_s += CYCLE_S
            twist = led.twist(time_s, PlacedTool(master.rotation, master.position + step * way), hand)
        assert twist is not None
        assert twist[0] < -0.3, f"0.1 m back, and no more than {SLACK_M} m were kept"


def test_an_impossible_step_of_the_master_is_no_command() -> None:
    master = PlacedTool(np.eye(3), np.zeros(3))
    led = LedPose(1.0)
    led.couple(master, master, own_axes=False)
    assert led.twist(0.0, master, master) is not None
    away = PlacedTool(np.eye(3), np.array([1.1 * JUMP_M, 0.0, 0.0]))
    assert led.twist(CYCLE_S, away, master) is None
    assert not led.is_coupled


@pytest.mark.long
def test_an_object_between_two_hands_is_led_as_one() -> None:
    led = Led(scale=0.5, robot="dawm")
    led.clutch.hand, led.clutch.command = "object", OperatorCommand(grip=Grip.OBJECT)
    led.drive(0.1)
    hands = Hands(led.slave.robot)
    hands.place(led.slave.now)
    start = hands.positions.mean(axis=0)
    master = led.poses()[0].position
    led.drive(0.8, z=0.1, rz=0.2)
    led.drive(1.6)
    hands.place(led.slave.now)
    held = led.slave.teleoperator.held
    assert held is not None
    assert max(held.parted(hands.rotations, hands.positions)) < 5e-6
    way = led.poses()[0].position - master
    assert hands.positions.mean(axis=0) - start == pytest.approx(0.5 * way, abs=1e-3)


@pytest.mark.long
def test_one_robot_of_a_cell_leads_the_other_through_the_gate() -> None:
    drive, clutch = StackDrive("gr", DrivingMode.COUPLED), Clutch()
    stack, leader = drive.stack, Teleoperator(model("fr"), CYCLE_S, DrivingMode.COUPLED)
    stack.acquire("fr", "somebody")

    def view(name: str) -> RobotView:
        return RobotView.from_state(stack.states[name])

    def tool(name: str) -> Array:
        return stack.cell.robots[name].forward(np.array(stack.states[name].q))[:3, 3]

    master = LedInput(clutch, Master(drive.teleoperator, model("fr"), lambda: (view("fr"), view("gr")), 0.5))
    start = tool("fr"), tool("gr")
    for cycle in range(170):
        stack.cycle()
        leader.command = OperatorCommand({"z": 0.15} if 20 < cycle < 100 else {})
        stack.ask("fr", leader.increment(View(view("fr"))))
        clutch.is_clutched = cycle > 20
        command = master.read(view("gr").time_s)
        assert command is not None
        assert np.linalg.norm([command.rates.get(axis, 0.0) for axis in "xyz"]) <= MOST_M_S + 1e-9
        drive.teleoperator.command = command
        stack.ask("gr", drive.teleoperator.increment(View(view("gr"))))
    ways = tool("fr") - start[0], tool("gr") - start[1]
    assert ways[0][2] > 0.08
    assert ways[1] == pytest.approx(0.5 * ways[0], abs=2e-3)


@pytest.mark.long
def test_a_twin_driven_joint_by_joint_leads_its_arm_through_the_gate(tmp_path: Path) -> None:
    """The cell of the guide; the twin's increments are those of some device's encoders."""
    steps_of_guide = steps(GUIDE.read_text(encoding="utf-8"))
    (text,) = (step.text for step in steps_of_guide if (step.kind, step.argument) == ("write", "twin.yaml"))
    (tmp_path / "twin.yaml").write_text(text, encoding="utf-8")
    stack = VirtualCell(tmp_path / "twin.yaml")
    arm, twin = (stack.cell.robots[name] for name in ("arm", "twin"))
    teleoperator = Teleoperator(arm, stack.cell.description.cycle_s, DrivingMode.DECOUPLED)
    stack.run_until_ready()
    for name in ("arm", "twin"):
        stack.acquire(name, "somebody")

    def view(name: str) -> RobotView:
        return RobotView.from_state(stack.states[name])

    def tools() -> list[Array]:
        return [robot.forward(view(robot.name).q) for robot in (twin, arm)]

    clutch = Clutch()
    master = LedInput(clutch, Master(teleoperator, twin, lambda: (view("twin"), view("arm")), 0.25))
    before, outcomes = tools(), set()
    for cycle in range(-20, 350):
        stack.cycle()
        clutch.is_clutched = cycle >= 0
        pace = 8e-4 * min(1.0, max(0.0, cycle / 40), max(0.0, (180 - cycle) / 40))
        moved = stack.ask("twin", pace * np.array([1.0, 0.4, -0.6, 0.2, 0.3, 0.5]))
        command = master.read(view("arm").time_s)
        assert command is not None
        teleoperator.command = command
        led = stack.ask("arm", teleoperator.increment(View(view("arm"))))
        teleoperator.take_verdict(led)
        outcomes |= {verdict.outcome for verdict in (moved, led) if verdict is not None}
    assert outcomes == {Outcome.ADMITTED}
    after = tools()
    ways = [now[:3, 3] - then[:3, 3] for now, then in zip(after, before, strict=True)]
    assert np.linalg.norm(ways[0]) > 0.05
    assert ways[1] == pytest.approx(0.25 * ways[0], abs=1e-3)
    turns = [pin.log3(now[:3, :3] @ then[:3, :3].T) for now, then in zip(after, before, strict=True)]
    assert turns[1] == pytest.approx(turns[0], abs=2e-3)
