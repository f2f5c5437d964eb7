"""How much each gain of the quadratic programme matters: `python -m deltaq_experiments.gain_sensitivity`.

Each gain in turn is halved and doubled, all others as they are, and makes the same short runs: the leader moves about
and is tracked, and it attacks the lens of a camera whose focus is fixed. No gate stops them. Their seeds begin at 200,
beyond those of the pages of figures, by which the gains were chosen.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deltaq_controllers.camera.qp_follower import QpFollower
from deltaq_controllers.camera.qp_gains import QpGains
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.leader.attacking import AttackingLeader
from deltaq_experiments.attack_starts import attack_start
from deltaq_experiments.figures import save
from deltaq_experiments.options import Options
from deltaq_experiments.scene import VIEW_DISTANCE_M, load
from deltaq_experiments.tracking import scripted_leader
from deltaq_experiments.ungated import record_ungated
from deltaq_experiments.virtual import RunRecord
from deltaq_launch.program import run_program
from deltaq_protocol.arrays import Array

FIRST_SEED = 200
FACTORS = (0.5, 2.0)
OPTIONS = Options(controller="qp", leader_speed_m_s=0.5, duration_s=6.0, settle_s=1.0, gated=False)
PAGE = Path("docs/explanation/gain-sensitivity.md")
PICTURE = Path("docs/explanation/pictures/gain-sensitivity.png")
RUNS = ("tracking", "attack")
UNITS = ("angle [°]", "distance [cm]")


class Errors(NamedTuple):
    """Largest errors of a run, after its settling time."""

    angle_deg: float
    distance_cm: float


Tried = Mapping[str, Sequence[Errors]]
"""Of each of `RUNS` the errors of each seed."""


class GainTrial(NamedTuple):
    """A cell and where the attack of a seed begins in it, which gains have no part in."""

    scene: Scene
    options: Options
    focus: Array
    start: Mapping[str, Array]


def situations(seeds: Sequence[int]) -> list[GainTrial]:
    """Where the runs of some seeds begin."""
    scene = load(OPTIONS)
    focus = scene.leader.forward(scene.leader.home)[:3, 3]
    camera = QpFollower(scene, VIEW_DISTANCE_M, focus)
    return [
        GainTrial(scene, replace(OPTIONS, seed=seed), focus, attack_start(scene, camera, seed))
        for seed in seeds
    ]


def tried(gains: QpGains, begun: Sequence[GainTrial]) -> Tried:
    """What some gains make of all runs."""
    return {
        "tracking": [_tracked(gains, one) for one in begun],
        "attack": [_attacked(gains, one) for one in begun],
    }


def _tracked(gains: QpGains, begun: GainTrial) -> Errors:
    camera = QpFollower(begun.scene, VIEW_DISTANCE_M, gains=gains)
    leader = scripted_leader(begun.options, begun.scene)
    return _errors(begun, camera, record_ungated(begun.options, begun.scene, camera, leader, {}))


def _attacked(gains: QpGains, begun: GainTrial) -> Errors:
    camera, options, scene = (
        QpFollower(begun.scene, VIEW_DISTANCE_M, begun.focus, gains),
        begun.options,
        begun.scene,
    )
    leader = AttackingLeader(scene.leader, scene.robot, scene.cycle_s, options.leader_speed_m_s, options.seed)
    return _errors(begun, camera, record_ungated(options, scene, camera, leader, begun.start))


def _errors(begun: GainTrial, camera: QpFollower, recording: RunRecord) -> Errors:
    trace = recording.trace
    views = trace.views(camera, begun.scene)[trace.time_s >= begun.options.settle_s]
    return Errors(float(views[:, 0].max()), 100.0 * float(np.abs(views[:, 1] - VIEW_DISTANCE_M).max()))


def variants(names: Sequence[str] = QpGains._fields) -> Iterator[tuple[str, float, QpGains]]:
    """Each gain with each factor, and the gains that this makes."""
    for name in names:
        for factor in FACTORS:
            yield name, factor, QpGains()._replace(**{name: factor * getattr(QpGains(), name)})


def cells(of: Tried) -> Iterator[tuple[float, float]]:
    """Median and worst over the seeds: angle and distance of the first of `RUNS`, then of the next."""
    for run in RUNS:
        for values in zip(*of[run], strict=True):
            yield float(np.median(values)), max(values)


def page(seeds: Sequence[int], usual: Tried, rows: Sequence[tuple[str, float, Tried]]) -> str:
    """The table, and what it shows."""
    about = (__doc__ or "").split("\n\n", 1)[1].strip()
    heads = [f"{run}, {unit}" for run in RUNS for unit in UNITS]
    lines = [
        "# The gains of the camera follower, halved and doubled",
        "",
        "Written by `python -m deltaq_experiments.gain_sensitivity`.",
        about,
        "",
        f"Seeds {seeds[0]} to {seeds[-1]}, {OPTIONS.length_s:g} s each, of which the first is left out, the leader",
        f"asked for {OPTIONS.leader_speed_m_s:g} m/s. Each cell has the largest error of a run: the median over the",
        "seeds; the worst. How near the attacker came is not in it: a smaller error may be bought with clearance.",
        "[What the gains are](../reference/gains.md#the-quadratic-programme)",
        "",
        f"![Median and worst error with each gain halved and doubled](pictures/{PICTURE.name})",
        "",
        f"| gain | times | {' | '.join(heads)} |",
        f"| --- | --- | {' | '.join('---' for _ in heads)} |",
        _row("as they are", "", usual),
    ]
    lines += [_row(f"`{name}`", f"{factor:g}", of) for name, factor, of in rows]
    return "\n".join(lines) + "\n"


def _row(name: str, factor: str, of: Tried) -> str:
    return (
        f"| {name} | {factor} | {' | '.join(f'{median:.3g}; {worst:.3g}' for median, worst in cells(of))} |"
    )


def draw(usual: Tried, rows: Sequence[tuple[str, float, Tried]], file: Path) -> None:
    """A picture: a line for each gain, from the median to the worst of the halved and the doubled one.

    Raises:
        DeltaqError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator

    names = list(dict.fromkeys(name for name, _, _ in rows))
    figure = Figure(figsize=(9.0, 0.24 * len(names) + 1.2), layout="constrained", dpi=90)
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(1, len(RUNS) * len(UNITS), sharey=True)
    heads = [f"{run}\n{unit}" for run in RUNS for unit in UNITS]
    for column, (ax, head) in enumerate(zip(axes, heads, strict=True)):
        median, worst = list(cells(usual))[column]
        ax.axvspan(median, worst, color="0.85")
        ax.axvline(median, color="0.5", linewidth=0.8)
        for name, factor, of in rows:
            median, worst = list(cells(of))[column]
            colour, height = ("tab:blue", 0.18) if factor < 1.0 else ("tab:red", -0.18)
            place = len(names) - 1 - names.index(name) + height
            ax.plot([median, worst], [place, place], color=colour, linewidth=1.0)
            ax.plot([median], [place], "o", color=colour, markersize=3.0)
        ax.set_xscale("log")
        ax.set_title(head, fontsize=8)
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_locator(NullLocator())
        ax.margins(y=0.01)
        ax.tick_params(labelsize=7)
        ax.grid(axis="x", color="0.92")
    axes[0].set_yticks(range(len(names)), list(reversed(names)), fontsize=7)
    figure.suptitle(
        "largest errors, median to worst seed; blue: halved, red: doubled, grey: as they are", fontsize=8
    )
    save(figure, file)


def main(argv: Sequence[str] | None = None) -> int:
    """Run all, and write page and picture."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_experiments.gain_sensitivity",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--root", type=Path, default=Path(), help="where docs/ lies (default: here)")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each kind (default: %(default)s)")
    parser.add_argument("--gain", nargs="+", choices=QpGains._fields, default=QpGains._fields, metavar="GAIN",
                        help="only these, on the page too (default: all)")  # fmt: skip
    given = parser.parse_args(argv)
    if given.seeds < 1:
        parser.error(f"--seeds {given.seeds}: at least 1")
    seeds = range(FIRST_SEED, FIRST_SEED + given.seeds)
    begun = situations(seeds)
    usual = tried(QpGains(), begun)
    rows = []
    for name, factor, gains in variants(given.gain):
        rows.append((name, factor, tried(gains, begun)))
        print(_row(f"`{name}`", f"{factor:g}", rows[-1][2]), flush=True)
    (given.root / PICTURE).parent.mkdir(parents=True, exist_ok=True)
    (given.root / PAGE).write_text(page(seeds, usual, rows), encoding="utf-8")
    draw(usual, rows, given.root / PICTURE)
    return 0


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.gain_sensitivity")
