"""What floods cost others, in one run: `python -m deltaq_proofs.floods --json`.

A cell of real processes is started, one robot moves, and one flood after another goes at the HLI's ports. For each:
states a second at an observer and braked cycles without it and with it, and how long a stop takes. It wants a machine
on which nothing else runs.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from dataclasses import asdict
from pathlib import Path
from statistics import median

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.program import run_program
from deltaq_proofs.floods.attacks import ATTACKS
from deltaq_proofs.floods.measure import FloodRow, measure
from deltaq_testing.faults.panel import must_have
from deltaq_testing.private_cell import write_private_cell

_HEADING = (
    f"{'flood':30} {'steps/s':>9} {'states/s':>15} {'kept':>7} {'braked':>9} {'stop ms':>13} {'by line':>13}"
    f" {'encrypted':>13}   (stops: median, longest)"
)


def main(arguments: list[str] | None = None) -> None:
    """Measure, a row an attack."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_proofs.floods",
        description="Figures of others beside each flood of the list.",
    )
    parser.add_argument("--cell", default="lab", help="whose like is started, on ports of its own")
    parser.add_argument("--robot", default="fr", help="the one that moves")
    parser.add_argument(
        "--attack", action="append", choices=ATTACKS, help="only this one; may be given again"
    )
    parser.add_argument("--duration-s", type=float, default=5.0, help="of each count (default: %(default)s)")
    parser.add_argument(
        "--attackers", type=int, default=2, help="processes that flood (default: %(default)s)"
    )
    parser.add_argument("--stops", type=int, default=10, help="each way, in a flood (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line instead of a table")
    given = parser.parse_args(arguments)
    _must_be_positive(parser, given)
    with tempfile.TemporaryDirectory() as folder:
        file = write_private_cell(Path(folder), given.cell)
        must_have(load_cell(file), given.robot)
        if not given.json:
            print(_HEADING)
        names = given.attack or ATTACKS
        for row in measure(str(file), given.robot, names, given.duration_s, given.attackers, given.stops):
            print(json.dumps(asdict(row)) if given.json else _line(row), flush=True)


def _must_be_positive(parser: argparse.ArgumentParser, given: argparse.Namespace) -> None:
    if not 0.0 < given.duration_s < math.inf:
        parser.error(f"--duration-s {given.duration_s:g}: more than 0")
    if given.attackers < 1:
        parser.error(f"--attackers {given.attackers}: at least 1")
    if given.stops < 1:
        parser.error(f"--stops {given.stops}: at least 1")


def _line(row: FloodRow) -> str:
    def ms(took: tuple[float | None, ...]) -> str:
        if not took:
            return "-"
        times = sorted(math.inf if one is None else one * 1000.0 for one in took)
        return f"{median(times):.0f}, {times[-1]:.0f}"

    states = f"{row.without.states_hz:.0f} -> {row.during.states_hz:.0f}"
    braked = f"{row.without.braked_cycles} -> {row.during.braked_cycles}"
    return (
        f"{row.attack:30} {row.steps_s:9.0f} {states:>15} {row.states_kept:7.1%} {braked:>9} "
        f"{ms(row.stop_s):>13} {ms(row.line_stop_s):>13} {ms(row.encrypted_stop_s):>13}"
    )


if __name__ == "__main__":
    run_program(main, "deltaq_proofs.floods")
