"""`deltaq key`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def key(file: Annotated[Path, typer.Argument(help="File to write; it must not exist.")]) -> None:
    """Make a key for services that reach one another off the loopback, in a file that only its owner may read."""
    from deltaq_services.guarded_key import KEY_FILE, write_new_key

    write_new_key(file)
    typer.echo(
        f"{file}: set {KEY_FILE} to its path for HLI, SIM and every Robot Server, on each of their machines"
    )
