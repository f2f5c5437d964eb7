"""`python -m deltaq_controllers.operated --robot fr`: the lines are those of `deltaq_protocol.driving`."""

import argparse
import asyncio
import contextlib
import os
import signal
import sys
from asyncio.subprocess import DEVNULL
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from deltaq_cell.machine_code import folder, is_complete
from deltaq_cell.robot import RobotModel
from deltaq_cell.roles import camera_roles
from deltaq_controllers.camera import FOLLOWS
from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.in_use import CameraInUse
from deltaq_controllers.camera.outlook import Outlook
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.live import (
    REFUSED,
    UNREACHABLE,
    USAGE,
    cell_model,
    control_loop,
    model_of,
    robot_models,
)
from deltaq_controllers.modes.practice import practise
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operated.pilot import Pilot
from deltaq_controllers.operated.reach import ReachPlanner
from deltaq_controllers.operated.shell import OperatedRobot
from deltaq_controllers.operator_input.master import Master, looking_at
from deltaq_controllers.teleoperation import teleoperator_for
from deltaq_protocol import connect
from deltaq_protocol.client import DEFAULT_ADDRESS, Cell
from deltaq_protocol.driving import DriverMessage, DriverReport, DriverStage, DrivingMode
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError

_PACKAGE = Path(__file__).parents[1]
_PATIENT = 10
"""Niceness of the compiler: the cell goes first."""
VIEW_M = 1.25
"""View distance to begin with [m]."""


def say(said: DriverMessage) -> None:
    """Send a line."""
    print(said.model_dump_json(), flush=True)


async def operate(options: argparse.Namespace) -> None:
    """Connect, get ready, and drive until the input ends."""
    lines = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    say(DriverReport(stage=DriverStage.STARTING, mode=DrivingMode.JOINT))
    async with connect(options.url, client=f"driver of {options.robot}") as cell:
        await drive_by_lines(cell, options.robot, lines, say)


async def drive_by_lines(
    cell: Cell, robot: str, lines: asyncio.StreamReader, say: Callable[[DriverMessage], None]
) -> None:
    """Get ready, so that nothing is left to be compiled once the robot is leased, and drive until the input ends.

    Args:
        cell: connection to the cell.
        robot: its name.
        lines: of requests.
        say: sends a line.

    Raises:
        ControllerError: the cell has no such robot.
    """
    with ExitStack() as stack:
        teleoperator = teleoperator_for(cell, robot, stack, hands_may_leave=None)
        is_to_compile = teleoperator.robot.description.camera is not None and not _is_camera_compiled()
        compiling = asyncio.ensure_future(_compiled_camera() if is_to_compile else asyncio.sleep(0))
        pilot = Pilot(
            teleoperator,
            partial(_follower, cell, teleoperator.robot, compiling),
            partial(_master, cell, teleoperator),
            lambda: ReachPlanner(cell_model(cell.description), robot),
        )
        await asyncio.to_thread(_make_ready, pilot, teleoperator)
        operated = OperatedRobot(cell, robot, pilot, say)
        listening = asyncio.ensure_future(operated.listen(lines))
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, listening.cancel)
        try:
            with control_loop():
                await operated.run()
        finally:
            compiling.cancel()
            await asyncio.gather(compiling, return_exceptions=True)


def _make_ready(pilot: Pilot, teleoperator: Teleoperator) -> None:
    """Prepare every mode: one that is chosen while the lease is held costs no cycle."""
    for mode in DrivingMode:
        # the robot cannot be driven in some, and says so when it is asked to
        with contextlib.suppress(DeltaqError):
            pilot.prepare(mode)
    practise(teleoperator)


def _is_camera_compiled() -> bool:
    return is_complete(folder(_PACKAGE), FOLLOWS, _PACKAGE)


async def _compiled_camera() -> None:
    """Have the camera's law compiled by another process: this one could not drive meanwhile. Once is enough."""
    compiler = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "deltaq_controllers.camera", FOLLOWS, stdin=DEVNULL, stdout=DEVNULL
    )
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.setpriority(os.PRIO_PROCESS, compiler.pid, _PATIENT)
    try:
        await compiler.wait()
    except asyncio.CancelledError:
        compiler.kill()
        await compiler.wait()
        raise


def _follower(cell: Cell, robot: RobotModel, compiling: asyncio.Future[None]) -> CameraInUse:
    """The paper's follower of the robot that the cell says, which can be told to follow any other.

    Raises:
        ControllerError: there is no other robot, this one carries no camera, or its law is still being compiled.
    """
    others = [name for name in cell.robots if name != robot.name]
    if not others or robot.description.camera is None:
        raise ControllerError(f"{robot.name} carries no camera, or there is no other robot to follow")
    if not compiling.done():
        raise ControllerError(
            "the camera controller is being compiled, for about a minute; then release the robot and take it again"
        )
    model = cell_model(cell.description)
    scenes = {name: Scene(model, robot.name, name) for name in others}
    cameras = {name: camera_controller_named(FOLLOWS, scene, VIEW_M) for name, scene in scenes.items()}
    leader = camera_roles(model.description, robot.name).leader
    return CameraInUse(cameras, leader, Outlook(model, robot.name))


def _master(cell: Cell, teleoperator: Teleoperator, master: str, scale: float) -> Master:
    """Another robot of the running cell as the master.

    Raises:
        ControllerError: there is none of that name, or it is the robot itself.
    """
    model = model_of(robot_models(cell.description), master)
    return Master(teleoperator, model, looking_at(cell, master, teleoperator.robot.name), scale)


def main() -> int:
    """Run the process; returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_controllers.operated",
        description="Drive a robot for an operator elsewhere: requests come in lines, until the input ends.",
    )
    parser.add_argument("--url", default=DEFAULT_ADDRESS, help="where the HLI serves (default: %(default)s)")
    parser.add_argument("--robot", required=True, help="robot to drive")
    try:
        asyncio.run(operate(parser.parse_args()))
    except DeltaqError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        if isinstance(error, ServiceUnreachableError):
            return UNREACHABLE
        return REFUSED if isinstance(error, RefusedError) else USAGE
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
