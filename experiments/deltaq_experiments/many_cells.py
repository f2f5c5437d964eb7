"""How many cells a machine carries: `python -m deltaq_experiments.many_cells` runs several side by side, each whole.

Each cell has its leader, its follower and its emulated KRCs, on ports of its own, and is measured by
`deltaq bench --live` while the others run. Nothing is shared but the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from deltaq_cell.load import load_cell
from deltaq_experiments.bench.live import LiveRun
from deltaq_launch.private_cell import write_private_cell
from deltaq_launch.program import run_program

CELLS = (1, 2, 3, 4)
DURATION_S = 30.0
WARM_UP_S = 10.0
"""For each cell: so long the machine may take to start one, and no window begins before the last has started."""
_COMMAND = "from deltaq_command import main; main()"


class CellsRow(BaseModel):
    """Some cells side by side.

    Attributes:
        cells: how many.
        started: how many of them came up, and ran to the end.
        admission_rate: of the robots of those, the lowest and the mean.
        decided_ms: longest p99 of a robot from a telegram to its decision [ms].
        processor_share: of the machine's processor time that all processes of those cells took.
        reference_in_time: lowest share of a cell's C reference, the same hops alone, that was back within a cycle.
    """

    model_config = ConfigDict(frozen=True)

    cells: int
    started: int
    admission_rate: tuple[float, float] | None
    decided_ms: float | None
    processor_share: float | None
    reference_in_time: float | None


def summary(cells: int, runs: Sequence[LiveRun], cycle_s: float, cores: int) -> CellsRow:
    """The row of some cells, of which these ran to the end."""
    if not runs:
        return CellsRow(
            cells=cells,
            started=0,
            admission_rate=None,
            decided_ms=None,
            processor_share=None,
            reference_in_time=None,
        )
    robots = [robot for run in runs for robot in run.robots.values()]
    rates = [robot.admission_rate or 0.0 for robot in robots]
    decided = [
        station.age_ms.p99 for robot in robots for station in robot.stations if station.station == "decided"
    ]
    spent_s = 1e-6 * sum(sum(run.processor_us.values()) for run in runs)
    return CellsRow(
        cells=cells,
        started=len(runs),
        admission_rate=(min(rates), float(np.mean(rates))),
        decided_ms=max((age for age in decided if age is not None), default=None),
        processor_share=spent_s / (cores * cycle_s),
        reference_in_time=min(float(run.reference["in_time"]) for run in runs),
    )


def measure(base: str, cells: int, duration_s: float) -> CellsRow:
    """Run so many cells like this one at the same time.

    Raises:
        CellError: there is no such cell.
    """
    with ExitStack() as stack:
        files = []
        for _ in range(cells):
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            files.append(write_private_cell(folder, base))
        benches = [stack.enter_context(_bench(file, duration_s, cells * WARM_UP_S)) for file in files]
        runs = [run for bench in benches if (run := _run_of(bench)) is not None]
    return summary(cells, runs, load_cell(base).cycle_s, os.cpu_count() or 1)


def _bench(cell: Path, duration_s: float, warm_up_s: float) -> subprocess.Popen[str]:
    options = ("--cell", str(cell), "--duration-s", str(duration_s), "--warm-up-s", str(warm_up_s))
    return subprocess.Popen(
        [sys.executable, "-c", _COMMAND, "bench", "--live", "--json", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


def _run_of(bench: subprocess.Popen[str]) -> LiveRun | None:
    """The run that a benchmark tells, None if its cell did not come up or did not last."""
    output, _ = bench.communicate()
    try:
        return LiveRun.model_validate(json.loads(output)["runs"][0])
    except (json.JSONDecodeError, KeyError, IndexError, ValidationError):
        return None


def rows(
    base: str, cells: Sequence[int], duration_s: float, on_row: Callable[[CellsRow], None]
) -> list[CellsRow]:
    """Measure each number of cells."""
    found = []
    for count in cells:
        found.append(measure(base, count, duration_s))
        on_row(found[-1])
    return found


def _words(row: CellsRow) -> str:
    if row.admission_rate is None:
        return f"{row.cells:5}   none came up"
    lowest, mean = row.admission_rate
    decided = "-" if row.decided_ms is None else f"{row.decided_ms:.1f}"
    return (
        f"{row.cells:5} {row.started:9} {lowest:12.2%} {mean:9.2%} {decided:>14} {row.processor_share:15.0%} "
        f"{row.reference_in_time:14.2%}"
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cell", default="lab", help="that each of them is like")
    parser.add_argument("--cells", type=int, nargs="+", default=CELLS, help="numbers that are measured")
    parser.add_argument("--duration-s", type=float, default=DURATION_S, help="of each measurement")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    options = parser.parse_args(argv)
    if min(options.cells) < 1:
        parser.error(f"--cells {options.cells}: at least 1")
    if not options.duration_s >= 0.5:
        parser.error(f"--duration-s {options.duration_s}: at least 0.5")
    if not options.json:
        print("cells   came up   lowest rate      mean   decided p99 ms   processor time   C in time")

    def show(row: CellsRow) -> None:
        if not options.json:
            print(_words(row), flush=True)

    found = rows(options.cell, options.cells, options.duration_s, show)
    if options.json:
        print(json.dumps([row.model_dump() for row in found], indent=2))


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.many_cells")
