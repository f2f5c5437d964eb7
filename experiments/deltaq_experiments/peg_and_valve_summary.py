"""Summary of the peg and valve task over some seeds, with the paper's conclusions that it supports."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median, quantiles
from typing import Any

from deltaq_experiments.peg_and_valve import OPERATORS, ModeFigures

MOST, FEW = 0.8, 0.2
"""Shares of the seeds from which figures support a conclusion, and up to which they are against it."""


@dataclass(frozen=True)
class Figure:
    """One figure of a run, with its name in tables.

    Attributes:
        name: its name with its unit.
        of: computes it from one run.
        decimals: number of decimals to print.
        worst: selects the worst of several values.
    """

    name: str
    of: Callable[[ModeFigures], float]
    decimals: int = 1
    worst: Callable[[Sequence[float]], float] = max

    def told(self, runs: Sequence[ModeFigures]) -> dict[str, Any]:
        """Median, lower and upper quartile, worst, and its seed."""
        values = [self.of(run) for run in runs]
        worst = self.worst(values)
        # of one run, all three are that one
        lower, _, upper = quantiles(values * 2 if len(values) == 1 else values, n=4, method="inclusive")
        return {
            "median": median(values),
            "quartiles": [lower, upper],
            "worst": worst,
            "seed": runs[values.index(worst)].seed,
        }

    def cell(self, runs: Sequence[ModeFigures]) -> str:
        """The median and the worst with its seed, as text for a table."""
        told = self.told(runs)
        middle, lower, upper, worst = (
            f"{value:.{self.decimals}f}" for value in (told["median"], *told["quartiles"], told["worst"])
        )
        return f"{middle} [{lower}, {upper}]; {worst} ({told['seed']})"


FIGURES = (
    Figure("task, s", lambda run: run.time_s, 0),
    Figure("peg off its axis, mm", lambda run: run.peg_off_mm),
    Figure("peg tilted, °", lambda run: run.peg_tilt_deg, 2),
    Figure("valve off its axis, mm", lambda run: run.valve_off_mm),
    Figure("within tolerance, % of the time at work", lambda run: 100 * run.kept, 0, min),
    Figure("least margin to a joint limit, %", lambda run: 100 * run.limit_margin, 0, min),
    Figure("slips", lambda run: sum(run.slips.values()), 0),
)

Runs = Mapping[str, Sequence[ModeFigures]]


def by_mode(runs: Sequence[ModeFigures]) -> dict[str, list[ModeFigures]]:
    """The runs of each mode that has any, in the paper's order."""
    found = {mode: [run for run in runs if run.mode == mode] for mode in OPERATORS}
    return {mode: ours for mode, ours in found.items() if ours}


def distributions(runs: Sequence[ModeFigures]) -> list[dict[str, Any]]:
    """For each mode: number of runs, number of finished runs, and the distribution of every figure."""
    return [
        {
            "mode": mode,
            "runs": len(ours),
            "done": sum(not run.undone for run in ours),
            "figures": {figure.name: figure.told(ours) for figure in FIGURES},
        }
        for mode, ours in by_mode(runs).items()
    ]


@dataclass(frozen=True)
class Conclusion:
    """A conclusion of the paper, and a question about it that the figures answer.

    Attributes:
        said: the conclusion of Hooper and Noakes, section V.
        asked: the question to the figures; empty if they do not concern it.
        modes: the modes that the question compares.
        holds: whether it holds for one seed, given the runs of these modes.
    """

    said: str
    asked: str
    modes: tuple[str, ...] = ()
    holds: Callable[..., bool] = lambda *_: False

    def counted(self, runs: Runs) -> tuple[int, int]:
        """In how many seeds it holds, and of how many."""
        seeds = [{run.seed: run for run in runs.get(mode, ())} for mode in self.modes]
        common = set.intersection(*(set(known) for known in seeds)) if seeds else set()
        return sum(self.holds(*(known[seed] for known in seeds)) for seed in common), len(common)

    def verdict(self, runs: Runs) -> str:
        """The answer of the figures to the question."""
        if not self.asked:
            return "not measured here"
        held, of = self.counted(runs)
        if not of:
            return "not run"
        share = held / of
        word = "supported" if share >= MOST else "not supported" if share <= FEW else "undecided"
        return f"{word}: in {held} of {of}"


CONCLUSIONS = (
    Conclusion(
        "joint control is not suitable for precisely controlling the hand",
        "is the peg farther off in `joint` than in any other mode?",
        tuple(OPERATORS),
        lambda joint, *others: joint.peg_off_mm > max(one.peg_off_mm for one in others),
    ),
    Conclusion(
        "the same",
        "does `joint` take more than twice as long as `decoupled`?",
        ("joint", "decoupled"),
        lambda joint, decoupled: joint.time_s > 2 * decoupled.time_s,
    ),
    Conclusion("joint control is best for leaving difficult configurations", ""),
    Conclusion(
        "decoupled control is best for transport and tool deployment",
        "does `decoupled` reach hole and valve sooner than `coupled`?",
        ("decoupled", "coupled"),
        lambda decoupled, coupled: decoupled.reach_s < coupled.reach_s,
    ),
    Conclusion(
        "self-motion allows for some optimization",
        "is the margin to limits larger than in `decoupled` alone?",
        ("self-motion", "decoupled"),
        lambda moved, decoupled: moved.limit_margin > decoupled.limit_margin,
    ),
    Conclusion(
        "the advisor is useful",
        "is the margin larger than in `decoupled` alone, and than by `self-motion`?",
        ("advisor", "decoupled", "self-motion"),
        lambda advised, *others: advised.limit_margin > max(one.limit_margin for one in others),
    ),
    Conclusion("with limited information on where obstacles are", ""),
    Conclusion(
        "coupled control is the most efficient mode",
        "is `coupled` done sooner than `decoupled`, `self-motion` and `advisor`?",
        ("decoupled", "self-motion", "advisor", "coupled"),
        lambda *runs: min(runs, key=lambda run: run.time_s).mode == "coupled",
    ),
    Conclusion(
        "the same",
        "is `coupled` within 15 % of `decoupled`'s time, with a larger margin to limits?",
        ("coupled", "decoupled"),
        lambda coupled, decoupled: (
            coupled.time_s < 1.15 * decoupled.time_s and coupled.limit_margin > decoupled.limit_margin
        ),
    ),
)
"""Hooper and Noakes draw these from use of the modes, and print no figure."""
