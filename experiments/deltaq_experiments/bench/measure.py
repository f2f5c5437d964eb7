"""All rows of `deltaq bench`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from deltaq_experiments.bench.decisions import near_obstacles, tracking
from deltaq_experiments.bench.rsi_reply import rsi_reply
from deltaq_experiments.bench.table import BenchTable


def run(
    cell_name: str | Path = "lab", cycles: int = 400, on_cycle: Callable[[int, int], None] | None = None
) -> BenchTable:
    """Measure.

    Args:
        cell_name: cell with a camera robot `fr` and a leader `gr`, whose decisions are timed while the camera tracks;
            the other rows are of shipped cells.
        cycles: cycles of tracking.
        on_cycle: called with the number of cycles done and the number of all.
    """
    return BenchTable(
        rows=(
            rsi_reply(),
            tracking(cell_name, cycles, on_cycle or (lambda _done, _of: None)),
            near_obstacles(),
        )
    )
