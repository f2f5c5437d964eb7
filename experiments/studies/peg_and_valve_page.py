"""Do the task over some seeds and write the page: `python -m studies.peg_and_valve_page --seeds 10`."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from deltaq_deploy.launch.program import run_program
from deltaq_experiments.peg_and_valve import (
    FIGURES,
    OFF_MM,
    OPERATORS,
    PEG_M,
    PLACED_M,
    TILT_DEG,
    ModeFigures,
    by_mode,
    once,
)
from deltaq_experiments.peg_and_valve_operators import ACTION_S, NOISE, NOISE_MEMORY_S, REACTION_S, SLIP

PAGE = Path("docs/notes/modes-compared.md")
SEEDS = 10
MOST, FEW = 0.8, 0.2
"""Shares of the seeds from which figures support a conclusion, and up to which they are against it."""

Runs = Mapping[str, Sequence[ModeFigures]]


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


BEFORE = f"""# The modes compared

`python -m studies.peg_and_valve_page` writes this page; `deltaq experiment peg-and-valve` prints the same figures.
A scripted operator inserts a peg by {1000 * PEG_M:.0f} mm into a hole and removes it, then turns a valve by 60 degrees,
with the gantry robot, in virtual time, through the gate. The seed places hole and valve within
{1000 * PLACED_M:.0f} mm and 10 degrees of their usual places, and determines the operator. Each cell of the table has
the median over the seeds, the quartiles in brackets, and the worst, with its seed.

"""

BETWEEN = f"""
`self-motion` and `advisor` are `decoupled` with a change of posture before each piece of work. In `joint` mode
the operator knows the goal of each joint, and divides each straight line into ten. Margins are fractions of half a
joint's range, at the goals. With the advisor the operator takes the option with the largest margin. The advisor's
computing time is not counted.

## Assumptions

Hole and valve are in free space, and a tolerance replaces contact: a peg more than {OFF_MM:g} mm off the hole's axis
or more than {TILT_DEG:g} degree tilted, or a hand more than {OFF_MM:g} mm off the valve's axis, would touch. The effect
of a touch is not in these figures.

The operator

- reacts after {REACTION_S:g} s, which varies by a tenth. Simple visual reactions
  take 0.2 to 0.3 s (Woods et al., Front. Hum. Neurosci. 9:131, 2015); the spread is an assumption.
- is noisy: a rate deviates by {100 * NOISE:.0f} % of the command, with a memory of {NOISE_MEMORY_S:g} s. Noise
  grows with the signal (Harris and Wolpert, Nature 394:780, 1998), of the order of a tenth in reaching
  (van Beers, Haggard and Wolpert, J. Neurophysiol. 91:1050, 2004). That this holds for a hand controller, and the
  memory, are assumptions.
- slips in {100 * SLIP:g} % of the actions, HEART's figure for a routine, highly practised, rapid task
  (Williams, 1986): wrong axis or joint, wrong way, late release, or wrong option, all equally likely. A continuous
  motion counts as an action every {ACTION_S:g} s. A slip ends one reaction later. These details are assumptions.

## Conclusions of the paper

Hooper and Noakes (section V) give no figures. A conclusion is supported if the answer to the question is yes for at
least {100 * MOST:.0f} % of the seeds, and not supported if it is yes for at most {100 * FEW:.0f} %.

"""

AFTER = """
The cell's description is complete, so the figures do not show the modes among unknown obstacles or in difficult
configurations. The scripted operator does not tire, does not learn, and sees poses where people see pictures.
"""


def page(runs: Sequence[ModeFigures]) -> str:
    """The page of some runs."""
    modes = by_mode(runs)
    figures = [
        "| mode | runs, done | " + " | ".join(figure.name for figure in FIGURES) + " |",
        "| --- | --- |" + " --- |" * len(FIGURES),
    ]
    for mode, ours in modes.items():
        done = sum(not run.undone for run in ours)
        cells = " | ".join(figure.cell(ours) for figure in FIGURES)
        figures.append(f"| `{mode}` | {len(ours)}, {done} | {cells} |")
    if min(len(ours) for ours in modes.values()) < SEEDS:
        figures += ["", f"Where a mode has fewer than {SEEDS} runs, there was no time for more."]
    for run in runs:
        if run.undone:
            figures += ["", f"`{run.mode}`, seed {run.seed}: {run.undone}."]
    answers = ["| the paper says | question to the figures | answer |", "| --- | --- | --- |"]
    for conclusion in CONCLUSIONS:
        answers.append(f"| {conclusion.said} | {conclusion.asked or '-'} | {conclusion.verdict(modes)} |")
    parts = (BEFORE, "\n".join(figures), "\n", BETWEEN, "\n".join(answers), "\n", AFTER)
    return "".join(parts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what has not been done yet, and write the page after each run."""
    parser = argparse.ArgumentParser(prog="python -m studies.peg_and_valve_page", description=__doc__)
    parser.add_argument("--root", type=Path, default=Path(), help="where docs/ lies (default: here)")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of each mode (default: %(default)s)")
    parser.add_argument(
        "--mode", action="append", choices=tuple(OPERATORS), help="only this mode, if not kept"
    )
    parser.add_argument(
        "--reports",
        type=Path,
        help="folder in which each run is kept; those that are there are not run again",
    )
    given = parser.parse_args(arguments)
    if given.seeds < 1:
        parser.error(f"--seeds {given.seeds}: at least 1")
    if given.reports is not None:
        given.reports.mkdir(parents=True, exist_ok=True)
    runs: list[ModeFigures] = []
    for seed in range(given.seeds):
        for mode in OPERATORS:
            file = None if given.reports is None else given.reports / f"{mode}-seed-{seed}.json"
            if file is not None and file.exists():
                runs.append(ModeFigures.model_validate_json(file.read_text(encoding="utf-8")))
            elif mode in (given.mode or OPERATORS):
                runs.append(once("lab", "gr", mode, seed))
                print(f"{mode}, seed {seed}: {runs[-1].time_s:.0f} s {runs[-1].undone}", flush=True)
                if file is not None:
                    file.write_text(runs[-1].model_dump_json(), encoding="utf-8")
    if not runs:
        parser.error("no run is kept, and none was made")
    (given.root / PAGE).write_text(page(runs), encoding="utf-8")
    return int(any(run.undone for run in runs))


if __name__ == "__main__":
    run_program(main, "studies.peg_and_valve_page")
