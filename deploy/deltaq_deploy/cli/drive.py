"""`deltaq drive`."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.cli.options import CellOption, JsonOption, RobotOption

if TYPE_CHECKING:
    from collections.abc import Callable

    from deltaq_cell.description import CellDescription
    from deltaq_cell.robot import RobotModel
    from deltaq_controllers.modes.switch import Teleoperator
    from deltaq_controllers.operator_input import OperatorInput
    from deltaq_protocol.messages import Description

MODES = ("joint", "decoupled", "self-motion", "coupled")
FRAMES = ("world", "tool")
SHOWN_EVERY_CYCLES = 10


def drive(
    robot: RobotOption,
    mode: Annotated[str, typer.Option(help=f"Mode to begin with: {', '.join(MODES)}.")] = "joint",
    cell: CellOption = "lab",
    frame: Annotated[str, typer.Option(help="Axes in which hands are moved: world or tool.")] = "world",
    script: Annotated[
        Path | None, typer.Option(help="A YAML list of steps: duration_s, move, mode, frame.")
    ] = None,
    gamepad: Annotated[
        Path | None, typer.Option(help="A joystick device, e.g. /dev/input/js0, in place of the keyboard.")
    ] = None,
    speed_m_s: Annotated[
        float, typer.Option(min=0.001, max=0.5, help="Hand speed of keyboard and gamepad.")
    ] = 0.1,
    json: JsonOption = False,
) -> None:
    """Drive a robot by keyboard, gamepad or script; whatever ends it, the robot comes to rest and is given back."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.cli.console import print_json
    from deltaq_deploy.running import known_robot

    if mode not in MODES:
        raise typer.BadParameter(f"no mode {mode!r}; there are {', '.join(MODES)}", param_hint="--mode")
    if frame not in FRAMES:
        raise typer.BadParameter(f"no frame {frame!r}; there are {', '.join(FRAMES)}", param_hint="--frame")
    if script is not None and gamepad is not None:
        raise typer.BadParameter("choose one of --script and --gamepad")
    description = load_cell(cell)
    known_robot(description, robot)
    choice = _Choice(description, robot, mode, frame, script, gamepad, speed_m_s)
    summary = choice.run()
    if json:
        print_json(summary)
    else:
        _show(summary)


class _Choice:
    """What was asked for."""

    def __init__(
        self,
        cell: CellDescription,
        robot: str,
        mode: str,
        frame: str,
        script: Path | None,
        gamepad: Path | None,
        speed_m_s: float,
    ) -> None:
        self._cell, self._robot, self._mode, self._frame = cell, robot, mode, frame
        self._script, self._gamepad, self._speed_m_s = script, gamepad, speed_m_s

    def run(self) -> dict[str, Any]:
        """Drive, and return the summary."""
        import asyncio

        return asyncio.run(self._drive())

    async def _drive(self) -> dict[str, Any]:
        import asyncio

        from deltaq_controllers.modes.motion import Frame, ModeName
        from deltaq_controllers.modes.switch import Teleoperator
        from deltaq_controllers.tally import Tally
        from deltaq_controllers.teleoperation import DriveLog, teleoperate
        from deltaq_deploy.running import OtherCellError
        from deltaq_protocol import connect

        async with connect(self._cell.hli, client="deltaq drive") as running:
            if running.description.cell != self._cell.cell:
                raise OtherCellError(
                    f"{self._cell.hli} serves cell {running.description.cell}, not {self._cell.cell}; "
                    "name the right one with --cell"
                )
            model = self._model(running.description)
            cycle_s = running.description.cycle_s
            teleoperator = Teleoperator(model, cycle_s, ModeName(self._mode), Frame(self._frame))
            log, tally, enough = DriveLog(teleoperator, cycle_s), Tally(), asyncio.Event()
            for number in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(number, enough.set)
            with self._input(teleoperator) as operator:
                show = _display(teleoperator, operator)

                def watch(q: Any) -> None:
                    log.add(q)
                    show()

                await teleoperate(running, teleoperator, operator, tally, watch, enough)
        return {"robot": self._robot, "legs": log.summary(), **tally.summary()}

    def _model(self, description: Description) -> RobotModel:
        from deltaq_controllers.live import model_of, robot_models

        return model_of(robot_models(description), self._robot)

    def _input(self, teleoperator: Teleoperator) -> OperatorInput:
        from deltaq_controllers.operator_input import Script
        from deltaq_controllers.operator_input_gamepad import Gamepad
        from deltaq_controllers.operator_input_keyboard import HELP, Keyboard

        if self._script is not None:
            return Script.load(self._script, teleoperator)
        if self._gamepad is not None:
            return Gamepad(teleoperator, self._gamepad, self._speed_m_s)
        print(HELP, file=sys.stderr)
        return Keyboard(teleoperator, speed_m_s=self._speed_m_s)


def _display(teleoperator: Teleoperator, operator: OperatorInput) -> Callable[[], None]:
    """Tells the mode and what limits it: in place on a terminal, otherwise a line for each change."""
    is_terminal = sys.stderr.isatty()
    told = ""
    cycles = 0

    def show() -> None:
        nonlocal told, cycles
        cycles += 1
        if cycles % SHOWN_EVERY_CYCLES:
            return
        limitation = teleoperator.limitation
        limit = f"limited, {limitation.limit.value}: {limitation.text}" if limitation else "free"
        text = f"{teleoperator.mode.value} ({teleoperator.frame.value})"
        if is_terminal:
            status = getattr(operator, "status", "")
            line = f"{text} | {status} | {limit}"
            sys.stderr.write(f"\r\x1b[2K{line[:150]}")
            sys.stderr.flush()
        elif f"{text} {limitation and limitation.what}" != told:
            told = f"{text} {limitation and limitation.what}"
            print(f"deltaq: {text}: {limit}", file=sys.stderr, flush=True)

    return show


def _show(summary: dict[str, Any]) -> None:
    from deltaq_deploy.cli.console import counts, print_table

    rows = [
        (
            leg["mode"],
            f"{leg['seconds']:.1f}",
            hand,
            f"{figures['moved_mm']:.2f}",
            f"{figures['turned_deg']:.3f}",
            f"{figures['farthest_mm']:.2f}",
            ", ".join(f"{what} {seconds:.1f} s" for what, seconds in leg["limited_s"].items()) or None,
        )
        for leg in summary["legs"]
        for hand, figures in leg["hands"].items()
    ]
    if sys.stderr.isatty():
        sys.stderr.write("\n")
    columns = ("mode", "s", "hand", "moved mm", "turned deg", "farthest mm", "limited by")
    print_table(f"{summary['robot']} was driven", columns, rows)
    print(f"gate: {counts(summary['gate'])}")
