"""The verb that drives a robot with a controller of the user's own."""

from __future__ import annotations

import inspect
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.options import CellOption, RobotOption, UrlOption

if TYPE_CHECKING:
    from deltaq import Controller


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
