"""The verbs that drive a robot: by hand, and with a controller of the user's own."""

from __future__ import annotations

import inspect
import signal
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.console import print_json
from deltaq_deploy.command.options import (
    CellOption,
    CriterionOption,
    HandsMayLeaveOption,
    JsonOption,
    RobotOption,
    TaskOption,
    TradeOffOption,
    UrlOption,
    task_of,
    two_criteria,
)
from deltaq_deploy.launch import BAD
from deltaq_protocol.errors import DeltaqError

if TYPE_CHECKING:
    from contextlib import ExitStack

    from deltaq import Controller
    from deltaq_cell.description import CellDescription
    from deltaq_controllers.modes.teleoperator import Teleoperator
    from deltaq_controllers.operator_input.interface import OperatorInput
    from deltaq_controllers.task import Task
    from deltaq_protocol.client import Cell
    from deltaq_protocol.errors import DeltaqError

MODES = ("joint", "decoupled", "self-motion", "advisor", "coupled")
FRAMES = ("world", "tool")
INPUTS = ("keyboard", "gamepad", "spacemouse")

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that bring the robot to rest and end the drive."""


JerkTimeOption = Annotated[
    float,
    typer.Option(
        min=0.0,
        max=1.0,
        help="Time in which a joint's acceleration rises to its limit, in modes that move hands; "
        "0 sets no limit to the jerk.",
    ),
]


def drive(
    robot: RobotOption,
    mode: Annotated[str, typer.Option(help=f"Mode to begin with: {', '.join(MODES)}.")] = "joint",
    cell: CellOption = "lab",
    url: UrlOption = None,
    frame: Annotated[str, typer.Option(help="Frame in which the hands are moved: world or tool.")] = "world",
    task: TaskOption = "",
    criterion: CriterionOption = None,
    trade_off: TradeOffOption = "",
    hands_may_leave: HandsMayLeaveOption = False,
    script: Annotated[
        Path | None,
        typer.Option(help="A YAML list of steps: duration_s, move, mode, frame, grip, option, outputs."),
    ] = None,
    device: Annotated[
        str,
        typer.Option("--input", help=f"Input device: {', '.join(INPUTS)}; the first one that is plugged in."),
    ] = "keyboard",
    master: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="Another robot of the cell whose tool leads the hand; the device of --input couples it.",
        ),
    ] = None,
    master_scale: Annotated[
        float,
        typer.Option(min=0.01, max=5.0, help="Displacement of the hand for each metre of the master's."),
    ] = 1.0,
    speed_m_s: Annotated[
        float, typer.Option(min=0.001, max=0.5, help="Hand speed to begin with, at full deflection.")
    ] = 0.1,
    jerk_time_s: JerkTimeOption = 0.0,
    json: JsonOption = False,
) -> None:
    """Drive a robot by hand or by script; however the drive ends, the robot comes to rest and is released."""
    import asyncio

    from deltaq_deploy.command.drive_display import show
    from deltaq_deploy.launch.cell_connection import described, known_robot

    _check(mode, frame, device, is_scripted=script is not None)
    description = described(cell, url, "deltaq drive")
    known_robot(description, robot)
    if master is not None:
        if script is not None:
            raise typer.BadParameter(
                "a script couples no master; leave out one of both", param_hint="--master"
            )
        known_robot(description, master)
    criteria = two_criteria(trade_off)
    advised = (task_of(task, criterion), jerk_time_s, criteria, hands_may_leave)
    led = None if master is None else (master, master_scale)
    choice = _Choice(description, robot, mode, frame, advised, script, device, led, speed_m_s)
    with ExitStack() as terminal:
        # a terminal is given back last: keys that are still held are not for the shell
        summary, error = asyncio.run(choice.drive(terminal))
        if json:
            print_json(summary)
        else:
            show(summary)
    if error is not None:
        raise error
    if script is not None and (summary["missed"] or any(each["error"] for each in summary["outputs"])):
        raise typer.Exit(BAD)


def _check(mode: str, frame: str, device: str, is_scripted: bool) -> None:
    """Check the words of the options.

    Raises:
        typer.BadParameter: naming those that there are.
    """
    for option, given, known in (("mode", mode, MODES), ("frame", frame, FRAMES), ("input", device, INPUTS)):
        if given not in known:
            raise typer.BadParameter(
                f"no {option} {given!r}; there are {', '.join(known)}", param_hint=f"--{option}"
            )
    if is_scripted and device != INPUTS[0]:
        raise typer.BadParameter(
            f"a script moves the robot alone; leave out --input {device}", param_hint="--script"
        )


@dataclass(frozen=True)
class _Choice:
    """Options of the drive; `advised` are the last arguments of `teleoperator_for`."""

    cell: CellDescription
    robot: str
    mode: str
    frame: str
    advised: tuple[Task, float, tuple[str, str] | None, bool]
    script: Path | None
    device: str
    led: tuple[str, float] | None
    speed_m_s: float

    async def drive(self, terminal: ExitStack) -> tuple[dict[str, Any], DeltaqError | None]:
        """Drive, and return the summary and the error that ended the drive, if one did.

        Args:
            terminal: gives the operator's device back.

        Raises:
            DeltaqError: the drive could not begin.
        """
        import asyncio

        from deltaq_controllers.live import ControlStatistics
        from deltaq_controllers.teleoperation import DriveLog, SignalLog, teleoperate, teleoperator_for
        from deltaq_deploy.command.drive_display import Display, summary
        from deltaq_deploy.launch.cell_connection import Where, check_same
        from deltaq_protocol import connect
        from deltaq_protocol.driving import DrivingMode, Frame

        async with connect(self.cell.hli, client="deltaq drive") as running:
            check_same(Where(self.cell.hli, self.cell.cell), running.description)
            cycle_s = running.description.cycle_s
            with ExitStack() as stack:
                mode, frame = DrivingMode(self.mode), Frame(self.frame)
                teleoperator = teleoperator_for(running, self.robot, stack, mode, frame, *self.advised)
                log, statistics = DriveLog(teleoperator, cycle_s), ControlStatistics()
                signals, enough = SignalLog(), asyncio.Event()
                for number in _ENDING:
                    asyncio.get_running_loop().add_signal_handler(number, enough.set)
                operator = terminal.enter_context(self._input(running, teleoperator))
                display = Display(teleoperator, operator, signals)

                def watch(q: Any) -> None:
                    log.add(q)
                    operator.reflect(teleoperator.reflection.share)
                    display.show()

                ended_by = None
                try:
                    await teleoperate(running, teleoperator, operator, statistics, watch, enough, signals)
                except DeltaqError as error:
                    if not log.legs:
                        raise
                    ended_by = error
        return summary(self.robot, log, statistics, signals, ended_by), ended_by

    def _input(self, running: Cell, teleoperator: Teleoperator) -> OperatorInput:
        from deltaq_controllers.live import model_of, robot_models
        from deltaq_controllers.operator_input import master
        from deltaq_controllers.operator_input.script import Script

        if self.script is not None:
            return Script.load(self.script, teleoperator)
        teleoperator.make_modes()  # the operator may switch to any of them
        if self.led is None:
            return self._held(running, teleoperator)
        name, scale = self.led
        model = model_of(robot_models(running.description), name)
        print(master.HELP, file=sys.stderr)
        look = master.looking_at(running, name, self.robot)
        leader = master.Master(teleoperator, model, look, scale)
        return master.LedInput(self._held(running, teleoperator), leader)

    def _held(self, running: Cell, teleoperator: Teleoperator) -> OperatorInput:
        """The device in the operator's hand."""
        from deltaq_controllers.operator_input import gamepad, keyboard, spacemouse

        if self.device == "gamepad":
            from deltaq_controllers.operator_input.interface import AskedViewDistance

            print(gamepad.HELP, file=sys.stderr)
            return gamepad.Gamepad(teleoperator, self.speed_m_s, AskedViewDistance(running, self.robot))
        keys = keyboard.Keyboard(teleoperator, speed_m_s=self.speed_m_s)
        if self.device == "spacemouse":
            print(f"{spacemouse.HELP}\n{keyboard.HELP}", file=sys.stderr)
            return spacemouse.SpaceMouse(teleoperator, keys)
        print(keyboard.HELP, file=sys.stderr)
        return keys


# The verb that drives a robot with a controller of the user's own.


def run(
    controller: Annotated[
        str,
        typer.Argument(
            metavar="FILE.py:NAME",
            help="A class without arguments, or an object, with the method `increment(view)`.",
        ),
    ],
    robot: RobotOption,
    cell: CellOption = "lab",
    url: UrlOption = None,
) -> None:
    """Drive a robot with a controller of your own, until it returns None or Ctrl-C."""
    import deltaq
    from deltaq_deploy.launch.cell_connection import Where

    made = loaded(controller)
    with deltaq.connect(Where.of(cell, url, robot).hli, client="deltaq run") as running:
        try:
            with running.lease(robot) as leased:
                leased.run(made)
            why = "the controller has ended"
        except KeyboardInterrupt:
            why = "interrupted"
    typer.echo(f"{robot} is at rest: {why}")


def loaded(named: str) -> Controller:
    """The controller that `FILE.py:NAME` names.

    Raises:
        typer.BadParameter: there is no such file or name in it, or the object has no method `increment`.
    """
    path, colon, name = named.rpartition(":")
    file = Path(path)
    if not colon or not name or file.suffix != ".py":
        raise typer.BadParameter(f"{named!r} is not FILE.py:NAME")
    if not file.is_file():
        raise typer.BadParameter(f"there is no file {path}")
    spec = spec_from_file_location(file.stem, file.resolve())
    assert spec is not None  # of a file that ends in .py there is one
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.path.insert(0, str(file.resolve().parent))  # as `python FILE.py` does, for its imports
    spec.loader.exec_module(module)
    found: Any = getattr(module, name, None)
    if found is None:
        names = [key for key, value in vars(module).items() if hasattr(value, "increment")]
        raise typer.BadParameter(
            f"{path} has no {name}; with `increment` it has: {', '.join(names) or 'nothing'}"
        )
    if not callable(getattr(found, "increment", None)):
        raise typer.BadParameter(f"{named} has no method increment(view)")
    made: Any = found() if inspect.isclass(found) else found
    controller: Controller = made
    return controller
