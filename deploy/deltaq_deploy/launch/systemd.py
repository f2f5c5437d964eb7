"""Writes systemd units from the table of services: `python -m deltaq_deploy.launch.systemd CELL --to FOLDER [--real]`.

Without arguments it writes those of the emulated lab cell to `deploy/systemd`; `make docs` does.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from deltaq_cell.find import find_cell
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.services import Service, cell_services, console_service, metrics_exporter, select
from deltaq_deploy.launch.unit import TARGET, name_of, target, unit
from deltaq_protocol.errors import DeltaqError

FOLDER = Path(__file__).parents[3] / "deploy" / "systemd"
CELL = "lab"
PYTHON = Path("/opt/deltaq/bin/python")
HEADER = (
    "# Written by `python -m deltaq_deploy.launch.systemd` from deltaq_deploy.launch.services; do not edit.\n"
)


def units(
    cell_name: str = CELL, real: bool = False, python: Path = PYTHON, only: Sequence[str] = ()
) -> dict[str, str]:
    """The units of a cell by file name: one a service, and a target for all.

    Args:
        cell_name: the name of the cell, or the absolute path of its file.
        real: the robots are real, so there is no emulator.
        python: the interpreter that has deltaq installed.
        only: names or roles of the services that this machine runs; empty for all.

    Raises:
        DeltaqError: if there is no such cell or service.
    """
    services = _services(cell_name, real)
    chosen = select(services, only) if only else services
    texts = {name_of(service): unit(service, cell_name, python, chosen) for service in chosen}
    # metrics are for who has a Prometheus: they are there, and nobody starts them unasked
    texts[TARGET] = target(service for service in chosen if service.name != "metrics" or only)
    return {name: HEADER + text for name, text in sorted(texts.items())}


def write(texts: dict[str, str], folder: Path) -> None:
    """Write the units to a folder, in the place of all that are there."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("deltaq*"):
        if old.read_text(encoding="utf-8").startswith(HEADER):
            old.unlink()
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _services(cell_name: str, real: bool) -> tuple[Service, ...]:
    cell = load_cell(cell_name)
    services = cell_services(cell, cell_name, real)
    return (*services, console_service(cell, cell_name, services), metrics_exporter(cell_name))


def main(argv: Sequence[str] | None = None) -> None:
    """Write units."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_deploy.launch.systemd", description="systemd units of a cell"
    )
    parser.add_argument("cell", nargs="?", help="name or YAML file of the cell")
    parser.add_argument("--to", type=Path, metavar="FOLDER", help="folder to write them to")
    parser.add_argument("--real", action="store_true", help="real robots: no emulator")
    parser.add_argument(
        "--python", type=Path, default=PYTHON, help="that has deltaq installed (default: %(default)s)"
    )
    parser.add_argument(
        "--only", default="", help="services or kinds that this machine runs, e.g. robot-server,sim"
    )
    given = parser.parse_args(argv)
    if given.cell is None:
        write(units(), FOLDER)
        return
    if given.to is None:
        parser.error("--to FOLDER: say where they are to be written")
    only = [name.strip() for name in given.only.split(",") if name.strip()]
    try:
        file = find_cell(given.cell)
        shipped = given.cell if not Path(given.cell).exists() else str(file.resolve())
        write(units(shipped, given.real, given.python, only), given.to)
    except DeltaqError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"--to {given.to}: {error.filename} cannot be written: {error.strerror}")


if __name__ == "__main__":
    main()
