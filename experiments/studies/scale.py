"""What a larger plant costs the gate: `python -m studies.scale`, for 1 to 8 robots among 25 to 400 bodies.

Robots stand in rows so near that each can reach its neighbours, and sway about their homes; bodies lie between them.
All is drawn from a seed. Time is that of the gate's decisions alone, beside one raw `computeDistances` over the same
pairs in the same run. Robot Servers, HLI and controllers cost as much as one robot's, times the number of robots.
"""

import argparse
import gc
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.program import run_program
from deltaq_experiments.bench.decisions import RawDistances, Stopwatch
from deltaq_experiments.figures import save
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome
from deltaq_testing.virtual_cell.cell import VirtualCell

ROBOTS = (1, 2, 4, 8)
BODIES = (25, 100, 400)
PITCH_M = 2.2
"""Between bases of neighbours; a KR 16 reaches 1.6 m, so that tools can meet."""
NEAREST_M = 1.2
"""Of a body's centre to the axis of any base: farther inside no robot could leave its home."""
SWAY_RAD = 0.35
PERIODS_S = (5.0, 7.0, 6.0, 3.0, 4.0, 2.0)
"""Of the joints' sines; each robot begins at a phase of its own."""
BEFORE_CYCLES = 20
"""At a plant's start, not measured: first calls take memory."""


class ScaleRow(BaseModel, frozen=True):
    """One plant.

    Attributes:
        robots, bodies: how many.
        pairs: of bodies that the gate checks.
        admitted: share of decisions that admitted all that was asked.
        decision_ms: median of a decision [ms].
        decision_p99_ms: 99 of 100 take no longer [ms].
        cycle_ms: median of the decisions of a cycle together [ms].
        raw_ms: median of the reference [ms].
        ratio: median decision by the reference.
        cycle_share: of a cycle that its decisions take.
    """

    robots: int
    bodies: int
    pairs: int
    admitted: float
    decision_ms: float
    decision_p99_ms: float
    cycle_ms: float
    raw_ms: float
    ratio: float
    cycle_share: float


def plant(robots: int, bodies: int, seed: int = 0) -> dict[str, Any]:
    """The cell file of a plant: robots of the shipped lab's kind in rows, and bodies between them."""
    bases = _bases(robots)
    like = load_cell("lab").robots["fr"].model_dump(mode="json", exclude_unset=True)
    for field in ("mounted_on", "base", "driver"):
        like.pop(field)
    return {
        "cell": f"plant-{robots}-{bodies}",
        "cycle_s": 0.012,
        "gate": {
            "stop_distance_m": 0.05,
            "self_stop_distance_m": 0.02,
            "servo_lag_s": 0.204,
            "retreat_speed": 0.1,
        },
        "robots": {
            f"r{index}": like
            | {
                "driver": {"kind": "kinematic"},
                "mounted_on": ["floor"],
                "base": {"position_m": [float(x), float(y), 0.0], "rpy_deg": [0, 0, 90 * (index % 4)]},
            }
            for index, (x, y) in enumerate(bases)
        },
        "structure": {"floor": _body("box", [40.0, 40.0, 0.2], [0.0, 0.0, -0.111])}
        | dict(_scattered(bodies - 1, bases, np.random.default_rng(seed))),
    }


def measure(file: Path, cycles: int) -> ScaleRow:
    """Sway all robots of a plant for some cycles, and time every decision."""
    stack = VirtualCell(file)
    raw = RawDistances(stack.cell)
    stopwatch = Stopwatch(stack.sim.gate)
    stack.sim.gate = stopwatch
    stack.run_until_ready()
    for name in stack.arms:
        stack.acquire(name, "scale")
    references: list[float] = []
    before = stack.hli.counters.copy()
    gc.collect()
    for cycle in range(BEFORE_CYCLES + cycles):
        if cycle == BEFORE_CYCLES:
            stopwatch.seconds.clear()
            before = stack.hli.counters.copy()
        stack.cycle()
        for index, name in enumerate(stack.arms):
            stack.ask(name, _sway(cycle, index, stack.cell.description.cycle_s))
        references.append(raw.seconds({name: np.array(state.q_cmd) for name, state in stack.states.items()}))
    told = stack.hli.counters - before
    milliseconds = 1e3 * np.array(stopwatch.seconds)
    decision_ms, raw_ms = float(np.median(milliseconds)), 1e3 * float(np.median(references))
    cycle_ms = decision_ms * len(milliseconds) / cycles
    return ScaleRow(
        robots=len(stack.arms),
        bodies=len(stack.cell.structure),
        pairs=raw.pairs,
        admitted=told[f"verdicts_{Outcome.ADMITTED}"] / max(1, len(milliseconds)),
        decision_ms=decision_ms,
        decision_p99_ms=float(np.percentile(milliseconds, 99.0)),
        cycle_ms=cycle_ms,
        raw_ms=raw_ms,
        ratio=decision_ms / raw_ms,
        cycle_share=cycle_ms / 1e3 / stack.cell.description.cycle_s,
    )


def rows(
    robots: Sequence[int], bodies: Sequence[int], cycles: int, on_row: Callable[[ScaleRow], None]
) -> list[ScaleRow]:
    """Measure every plant of these sizes, the smallest first."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for count in robots:
            for several in bodies:
                file = Path(folder) / f"plant_{count}_{several}.yaml"
                file.write_text(yaml.safe_dump(plant(count, several)), encoding="utf-8")
                found.append(measure(file, cycles))
                on_row(found[-1])
    return found


def _bases(robots: int) -> Array:
    """(robots, 2) places of bases, two in a row [m]."""
    return np.array([(PITCH_M * (index % 2), PITCH_M * (index // 2)) for index in range(robots)])


def _scattered(bodies: int, bases: Array, random: np.random.Generator) -> Iterator[tuple[str, Any]]:
    """Bodies around and between the robots, none so near that no robot could move."""
    low, high = bases.min(axis=0) - 2.5, bases.max(axis=0) + 2.5
    placed = 0
    while placed < bodies:
        x, y = random.uniform(low, high)
        if np.linalg.norm(bases - (x, y), axis=1).min() < NEAREST_M:
            continue
        placed += 1
        size = random.uniform(0.05, 0.3, 3)
        centre = [float(x), float(y), float(random.uniform(0.2, 2.0))]
        yield f"body_{placed}", _body("box", [float(edge) for edge in size], centre)


def _body(kind: str, size_m: Sequence[float], position_m: Sequence[float]) -> dict[str, Any]:
    return {"shape": {"kind": kind, "size_m": list(size_m)}, "pose": {"position_m": list(position_m)}}


def _sway(cycle: int, robot: int, cycle_s: float) -> Array:
    """(6,) increment of a cycle: a sine of each joint, eased in over a second."""
    turns = 2.0 * np.pi / np.array(PERIODS_S)
    eased = min(1.0, cycle * cycle_s)
    return eased * SWAY_RAD * turns * np.cos(turns * cycle * cycle_s + robot) * cycle_s


def _draw(found: Sequence[ScaleRow], file: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.6), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    for bodies in sorted({row.bodies for row in found}):
        line = [row for row in found if row.bodies == bodies]
        sizes = [row.robots for row in line]
        ax.plot(
            sizes, [row.cycle_ms for row in line], "o-", label=f"all decisions of a cycle, {bodies} bodies"
        )
        ax.plot(sizes, [row.decision_ms for row in line], "o:", label=f"one decision, {bodies} bodies")
    ax.axhline(12.0, color="0.6", linestyle="--", linewidth=0.8)
    ax.set_xscale("log", base=2)
    ax.set_yscale("log")
    ax.set_xticks(
        sorted({row.robots for row in found}), [str(size) for size in sorted({row.robots for row in found})]
    )
    ax.set_xlabel("robots")
    ax.set_ylabel("[ms]")
    ax.grid(color="0.9")
    ax.legend(fontsize=7, ncols=2)
    save(figure, file)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, nargs="+", default=ROBOTS, help="sizes that are measured")
    parser.add_argument("--bodies", type=int, nargs="+", default=BODIES, help="of structure")
    parser.add_argument("--cycles", type=int, default=300, help="of each plant")
    parser.add_argument("--figure", type=Path, help="write a picture (.png)")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    options = parser.parse_args(argv)
    for name in ("robots", "bodies", "cycles"):
        found = getattr(options, name)
        if min(found if isinstance(found, Sequence) else [found]) < 1:
            parser.error(f"--{name} {found}: at least 1")
    columns = (
        "robots",
        "bodies",
        "pairs",
        "admitted",
        "decision",
        "p99",
        "cycle",
        "raw",
        "ratio",
        "of a cycle",
    )
    if not options.json:
        print(" ".join(f"{column:>10}" for column in columns) + "   [ms]")

    def show(row: ScaleRow) -> None:
        if not options.json:
            values = (row.robots, row.bodies, row.pairs, f"{row.admitted:.1%}", f"{row.decision_ms:.3f}")
            times = (
                f"{row.decision_p99_ms:.3f}",
                f"{row.cycle_ms:.3f}",
                f"{row.raw_ms:.3f}",
                f"{row.ratio:.3f}",
            )
            print(
                " ".join(f"{value:>10}" for value in (*values, *times, f"{row.cycle_share:.1%}")), flush=True
            )

    measured = rows(options.robots, options.bodies, options.cycles, show)
    if options.json:
        print(json.dumps([row.model_dump() for row in measured], indent=2))
    if options.figure is not None:
        _draw(measured, options.figure)


if __name__ == "__main__":
    run_program(main, "studies.scale")
