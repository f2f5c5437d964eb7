"""What a lookahead costs and what it saves: `python -m deltaq_experiments.lookahead`, in virtual time.

A controller answers every state of a robot after times that are drawn, and admissions take times that are drawn. Beside
the cycles that the robot braked stands the latency: from a state to the first setpoint that includes the answer to it.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from deltaq_experiments.figures import save
from deltaq_launch.program import run_program
from deltaq_protocol.guarded import Admission
from deltaq_verification.virtual_cell.cell import VirtualCell
from deltaq_verification.virtual_cell.delayed_wire import DelayedWire
from deltaq_verification.virtual_cell.jittery_client import JitteryClient
from deltaq_verification.virtual_cell.loaded_cell import LoadedCell
from deltaq_verification.virtual_cell.parts import Link, Process

LOOKAHEADS = (1, 2, 3)
CYCLES = 1000
SEEDS = 6
SETTLED_CYCLES = 5
"""From the first answer on; after these an answer is under way in every cycle."""
DQ = (1e-6, 0.0, 0.0, 0.0, 0.0, 0.0)
"""What is asked for in each cycle: so little that the gate admits it always [rad]."""


class AnswerTimes(BaseModel):
    """How late answers are.

    Attributes:
        controller_ms: median time from a state to its answer [ms], lognormal.
        sigma: of its logarithm.
        gate_ms: shortest and longest time from the gate to the Robot Server [ms], uniform.
    """

    model_config = ConfigDict(frozen=True)

    controller_ms: float
    sigma: float
    gate_ms: tuple[float, float]

    def __str__(self) -> str:
        low, high = self.gate_ms
        return f"controller {self.controller_ms:g} ms, sigma {self.sigma:g}; admission {low:g} to {high:g} ms"


ANSWER_TIMES = (
    AnswerTimes(controller_ms=8.0, sigma=0.12, gate_ms=(1.5, 2.0)),
    AnswerTimes(controller_ms=5.0, sigma=0.3, gate_ms=(2.0, 6.0)),
    AnswerTimes(controller_ms=8.0, sigma=0.3, gate_ms=(3.0, 11.0)),
    AnswerTimes(controller_ms=9.0, sigma=0.5, gate_ms=(4.0, 14.0)),
    AnswerTimes(controller_ms=5.0, sigma=0.5, gate_ms=(4.0, 20.0)),
)


class LookaheadRow(BaseModel):
    """One lookahead under one kind of delays.

    Attributes:
        delays: of controller and gate.
        lookahead_cycles: of the cell.
        cycles: of each seed.
        braked: cycles of the brake, seed by seed.
        latency_ms: mean time from the telegram of a state to the one whose reply includes its answer [ms].
    """

    model_config = ConfigDict(frozen=True)

    delays: AnswerTimes
    lookahead_cycles: int
    cycles: int
    braked: tuple[int, ...]
    latency_ms: float

    @property
    def braked_share(self) -> float:
        """Of all cycles."""
        return sum(self.braked) / (self.cycles * len(self.braked))


def measure(lab: LoadedCell, delays: AnswerTimes, seeds: int, cycles: int) -> LookaheadRow:
    """Drive the floor robot of a cell under these delays, once for each seed."""
    runs = [_run(lab, delays, seed, cycles) for seed in range(seeds)]
    latencies = np.concatenate([latency for _, latency in runs])
    return LookaheadRow(
        delays=delays,
        lookahead_cycles=lab.model.description.gate.lookahead_cycles,
        cycles=cycles,
        braked=tuple(braked for braked, _ in runs),
        latency_ms=1e3 * lab.model.description.cycle_s * float(latencies.mean()),
    )


def _run(lab: LoadedCell, delays: AnswerTimes, seed: int, cycles: int) -> tuple[int, np.ndarray]:
    """Cycles of the brake, and by increment that moved the robot the cycles that it took to do so."""
    cell = VirtualCell(lab)
    cell.run_until_ready()
    to_hli, to_server = _wires(delays, seed)
    client = cell.connect(partial(JitteryClient, robot="fr", dq=DQ), up=to_hli).core
    assert isinstance(client, JitteryClient)
    client.acquire()
    while client.token is None:
        cell.cycle()
    cell.plug(Link.SIM_SERVER, Process.ROBOT_SERVER, to_server, ["fr"], Admission)
    client.answers = True
    for _ in range(SETTLED_CYCLES):
        cell.cycle()
    counters = cell.arms["fr"].server.counters
    before = counters["admissions"]
    for _ in range(cycles):
        cell.cycle()
    moved = {
        verdict.seq: verdict.setpoint_cycle
        for verdict in client.verdicts
        if verdict.setpoint_cycle is not None
    }
    latency = np.array([cycle - client.answered[seq] for seq, cycle in moved.items()])
    return cycles - (counters["admissions"] - before), latency


def _wires(delays: AnswerTimes, seed: int) -> tuple[DelayedWire, DelayedWire]:
    of_controller, of_gate = random.Random(seed), random.Random(seed + 1000)
    low_ms, high_ms = delays.gate_ms
    return (
        DelayedWire(
            lambda: 1e-3 * delays.controller_ms * math.exp(delays.sigma * of_controller.gauss(0.0, 1.0))
        ),
        DelayedWire(lambda: 1e-3 * of_gate.uniform(low_ms, high_ms)),
    )


def rows(
    lookaheads: Sequence[int],
    seeds: int,
    cycles: int,
    on_row: Callable[[LookaheadRow], None],
    kinds: Sequence[AnswerTimes] = ANSWER_TIMES,
) -> list[LookaheadRow]:
    """Measure every lookahead under all kinds of delays.

    Raises:
        CellError: a cell may not have such a lookahead.
    """
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for lookahead in lookaheads:
            file = Path(folder) / f"ahead_{lookahead}.yaml"
            file.write_text(f"extends: lab.yaml\ncell: ahead\ngate: {{lookahead_cycles: {lookahead}}}\n")
            lab = LoadedCell.load(file)
            for delays in kinds:
                found.append(measure(lab, delays, seeds, cycles))
                on_row(found[-1])
    return found


def draw(found: Sequence[LookaheadRow], file: Path) -> None:
    """A line for each kind of delays: latency against braked cycles, a point for each lookahead.

    Raises:
        DeltaqError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    for delays, marker in zip(dict.fromkeys(row.delays for row in found), "osD^v", strict=False):
        line = [row for row in found if row.delays == delays]
        ax.plot(
            [row.latency_ms for row in line],
            [100.0 * row.braked_share for row in line],
            f"{marker}-",
            label=str(delays),
        )
        for row in line:
            ax.annotate(
                str(row.lookahead_cycles),
                (row.latency_ms, 100.0 * row.braked_share),
                textcoords="offset points",
                xytext=(5, 4),
                fontsize=7,
            )
    ax.set_yscale("symlog", linthresh=0.1)
    ax.set_ylim(bottom=-0.01)
    ax.set_xlabel("from a state to the setpoint that answers it, mean [ms]")
    ax.set_ylabel("cycles of the brake [%]")
    ax.grid(color="0.9")
    ax.legend(fontsize=7)
    save(figure, file)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lookaheads", type=int, nargs="+", default=LOOKAHEADS, help="that are measured")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of each row")
    parser.add_argument("--cycles", type=int, default=CYCLES, help="of each run")
    parser.add_argument("--figure", type=Path, help="write a picture (.png)")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    options = parser.parse_args(argv)
    for name in ("lookaheads", "seeds", "cycles"):
        given = getattr(options, name)
        if min(given if isinstance(given, Sequence) else [given]) < 1:
            parser.error(f"--{name} {given}: at least 1")
    if not options.json:
        print("lookahead   latency [ms]   braked     seed by seed")

    def show(row: LookaheadRow) -> None:
        if not options.json:
            seeds = ", ".join(map(str, row.braked))
            print(
                f"{row.lookahead_cycles:9}   {row.latency_ms:12.1f}   {row.braked_share:6.2%}     {seeds}   "
                f"({row.delays})",
                flush=True,
            )

    found = rows(options.lookaheads, options.seeds, options.cycles, show)
    if options.figure is not None:
        draw(found, options.figure)
    if options.json:
        print(json.dumps([row.model_dump() | {"braked_share": row.braked_share} for row in found], indent=2))


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.lookahead")
