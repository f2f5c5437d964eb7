"""What README shows of `import deltaq`, on a cell of real processes."""

import asyncio

import numpy as np
import pytest
from commands import deltaq as deltaq_command

import deltaq
from deltaq import MotionError, View, aio

pytestmark = pytest.mark.live

NEAR = 2e-3
"""How far a drive may still be from its setpoint when the robot is at rest [rad]."""


TURN = """
class Turn:
    def __init__(self):
        self.left = 20

    def increment(self, view):
        self.left -= 1
        return None if self.left < 0 else [0.001, 0, 0, 0, 0, 0]
"""


class Turn:
    """Turns A1 for some cycles."""

    def __init__(self, cycles: int) -> None:
        self.left = cycles

    def increment(self, view: View):
        self.left -= 1
        return None if self.left < 0 else [0.001, 0, 0, 0, 0, 0]


def test_a_script_moves_a_robot_by_joints_by_its_tool_by_steps_and_by_a_controller(ready_stack):
    with deltaq.connect(ready_stack.cell.hli) as cell, cell.lease("fr") as robot:
        start = np.array(robot.summary.home)
        target = start + np.array([0.1, 0.05, -0.05, 0.1, -0.1, 0.2])
        there = robot.move_to(target, speed=0.3)
        assert np.abs(np.array(there.q_cmd) - target).max() < 1e-6
        assert np.abs(robot.q - target).max() < NEAR
        before = robot.pose
        robot.move_tool(dz=0.05)
        moved = robot.pose - before
        assert moved[:3, 3] == pytest.approx([0, 0, 0.05], abs=2e-3)
        assert np.abs(moved[:3, :3]).max() < 2e-3
        assert robot.step([0.0005, 0, 0, 0, 0, 0]).outcome == "admitted"
        turn = Turn(10)
        robot.run(turn)
        assert turn.left < 0
        robot.home(speed=0.3)
        assert np.abs(robot.q - start).max() < NEAR


def test_an_impossible_motion_raises_an_error_with_reason_value_and_bound(ready_stack):
    with deltaq.connect(ready_stack.cell.hli) as cell, cell.lease("fr") as robot:
        with pytest.raises(ValueError, match=r"target of joint .* is not from"):
            robot.move_to([9.0, 0, 0, 0, 0, 0])
        with pytest.raises(ValueError, match=r"dq: shape \(2,\), the robot has 6 joints"):
            robot.step([0.0, 0.0])
        with pytest.raises(
            MotionError,
            match=r"^(velocity|acceleration)_limit: the increment of fr was (scaled|held): .* \(bound",
        ):
            robot.step([0.5, 0, 0, 0, 0, 0])
        assert robot.step([0.5, 0, 0, 0, 0, 0], check=False).outcome != "admitted"
        cell.stop()
        with pytest.raises(MotionError, match=r"^operator_stop: fr is held: .*deltaq reset --robot fr"):
            robot.home()


def test_asyncio_has_the_same_names_and_a_cancelled_task_leaves_the_robot_at_rest(ready_stack):
    async def drive() -> np.ndarray:
        async with aio.connect(ready_stack.cell.hli) as cell, cell.lease("fr") as robot:
            first, *others = robot.summary.home
            await robot.move_to([first + 0.1, *others])
            task = asyncio.create_task(robot.move_to([first + 1.0, *others]))
            async for _ in robot.states():
                if robot.q[0] > robot.summary.home[0] + 0.2:
                    break
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
        return np.array(robot.summary.home)

    home = asyncio.run(drive())
    ready_stack.wait_for(lambda before, after, _: np.array_equal(before, after))
    assert ready_stack.emulator()["q_setpoint"][0] < home[0] + 1.0


def test_a_controller_in_a_file_drives_a_robot_from_the_command_line(ready_stack, tmp_path):
    file = tmp_path / "turn.py"
    file.write_text(TURN)
    done = deltaq_command("run", f"{file}:Turn", "--robot", "fr", "--url", ready_stack.cell.hli)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "fr is at rest: the controller has ended\n"
    with deltaq.connect(ready_stack.cell.hli) as cell:
        assert next(cell.states("fr")).q_cmd[0] > ready_stack.robot.home[0] + 0.015


def test_a_controller_with_an_increment_of_the_wrong_length_ends_in_one_line(ready_stack, tmp_path):
    file = tmp_path / "turn.py"
    file.write_text(TURN.replace("[0.001, 0, 0, 0, 0, 0]", "[0.001]"))
    done = deltaq_command("run", f"{file}:Turn", "--robot", "fr", "--url", ready_stack.cell.hli)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "deltaq: dq: shape (1,), the robot has 6 joints\n"
