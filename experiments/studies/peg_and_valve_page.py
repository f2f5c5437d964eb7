"""Do the task over some seeds and write the page: `python -m studies.peg_and_valve_page --seeds 10`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from deltaq_experiments.peg_and_valve import (
    OFF_MM,
    OPERATORS,
    PEG_M,
    PLACED_M,
    TILT_DEG,
    ModeFigures,
    once,
)
from deltaq_experiments.peg_and_valve_person import ACTION_S, NOISE, NOISE_MEMORY_S, REACTION_S, SLIP
from deltaq_experiments.peg_and_valve_summary import CONCLUSIONS, FEW, FIGURES, MOST, by_mode
from deltaq_launch.program import run_program

PAGE = Path("docs/explanation/modes-compared.md")
SEEDS = 10


BEFORE = f"""# The modes compared

`python -m studies.peg_and_valve_page` writes this page; `deltaq peg-and-valve` prints the same figures.
A scripted operator brings the hand of the gantry robot to a hole, inserts a peg by {1000 * PEG_M:.0f} mm and removes
it, moves to a valve and turns it by 60 degrees, in virtual time, through the gate. The seed places hole and
valve within {1000 * PLACED_M:.0f} mm and 10 degrees of their usual places, and determines the operator; all modes
have the same seeds. Each cell of the table has the median over the seeds, with the quartiles in brackets, and then
the worst, with its seed.

"""

BETWEEN = f"""
`self-motion` and `advisor` are `decoupled` with a change of posture before each piece of work. In `joint` mode
the operator is assumed to know the goal of each joint, as with taught points, and divides each straight
line into ten; an operator who does not know the goals is slower still. Margins are fractions of half a joint's range,
at the goals. With the advisor the operator takes the option with the largest margin, and asks again when the hand
is stopped. The advisor's computing time is not counted.

## No contact, a tolerance

Hole and valve are in free space. A tolerance replaces contact: a peg more than {OFF_MM:g} mm off
the hole's axis or more than {TILT_DEG:g} degree tilted would touch the hole. A hand more than {OFF_MM:g} mm off the
valve's axis would touch the valve. That is an assumption. The effect of a touch (jamming, slipping, guiding) is not in
these figures; the operator continues as if nothing had happened.

## The operator

- Reacts after {REACTION_S:g} s, which varies by a tenth from one operator to the next. Simple visual reactions
  take 0.2 to 0.3 s (Woods et al., Front. Hum. Neurosci. 9:131, 2015); the spread is an assumption.
- Is noisy: a rate deviates by {100 * NOISE:.0f} % of the whole command, in all axes of the stick, with a memory
  of {NOISE_MEMORY_S:g} s. That noise grows with the signal is a result of Harris and Wolpert (Nature 394:780, 1998).
  A tenth is the order of magnitude that van Beers, Haggard and Wolpert find for reaching (J. Neurophysiol. 91:1050,
  2004). That this holds for a hand controller, and the memory, are assumptions.
- Slips in {100 * SLIP:g} % of the actions, HEART's figure for a routine, highly practised, rapid task
  (Williams, 1986): the operator takes the wrong axis or joint, pushes the wrong way, releases too late, or chooses
  the wrong option, all equally likely. A continuous motion counts as an action every {ACTION_S:g} s. A slip ends one
  reaction later. Kinds, actions and duration are assumptions.

## What the paper concludes

Hooper and Noakes (section V) report what they found in use, without figures. Here a question is asked of each seed.
A conclusion is called supported if the answer is yes for at least {100 * MOST:.0f} % of the seeds, and not supported
if it is yes for at most {100 * FEW:.0f} %.

"""

AFTER = """
All modes are used in one cell, whose description is complete. So these figures do not show how the modes perform if
obstacles are not known, nor how they lead out of difficult configurations. An operator that is a program does not
tire, does not learn, and sees poses where people see pictures.
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
