"""Run every claim over some seeds and write the page: `python -m deltaq_experiments.claims --seeds 10`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from deltaq_experiments.claims.claim import Claim, ClaimOutcome, JsonReport
from deltaq_experiments.claims.kept import KeptReports
from deltaq_experiments.claims.page import ENOUGH, page
from deltaq_experiments.claims.table import CLAIMS
from deltaq_experiments.figures import draw
from deltaq_experiments.report import ExperimentOutcome

PAGE = Path("docs/explanation/camera-figures.md")
PICTURES = Path("docs/explanation/pictures")


def run(claim: Claim, seed: int, picture: Path | None) -> JsonReport:
    """The report of one run of a claim; its figure is drawn to `picture`, if there is one.

    Raises:
        DeltaqError: if the run cannot be made.
    """
    module = import_module(f"deltaq_experiments.{claim.experiment}")
    outcome: ExperimentOutcome = module.run(replace(claim.options, seed=seed))
    if picture is not None:
        draw(outcome.panels, f"{claim.command} --seed {seed}", picture)
    report: JsonReport = outcome.report.model_dump(mode="json")
    return report


def main(arguments: Sequence[str] | None = None, claims: Sequence[Claim] = CLAIMS) -> int:
    """Run all of them and write the page; returns 1 if a joint passed a limit."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_experiments.claims", description=__doc__)
    parser.add_argument("--root", type=Path, default=Path(), help="where docs/ lies (default: here)")
    parser.add_argument(
        "--seeds",
        type=int,
        default=ENOUGH,
        help="runs of each claim, a minute or less each (default: %(default)s)",
    )
    parser.add_argument(
        "--reports",
        type=Path,
        default=None,
        help="folder in which each run's report is kept; those that are there, of the same code, are not run again",
    )
    parser.add_argument("--only", default="", help="run only what has this in its command")
    options = parser.parse_args(arguments)
    seeds: int = options.seeds
    root: Path = options.root
    if seeds < 1:
        parser.error(f"--seeds {seeds}: at least 1")
    pictures = root / PICTURES
    pictures.mkdir(parents=True, exist_ok=True)
    kept = KeptReports(options.reports)
    outcomes = [ClaimOutcome(claim, []) for claim in claims]
    for seed in range(seeds):
        for outcome in outcomes:
            claim = outcome.claim
            report = kept.get(claim, seed)
            if report is None and options.only in claim.command:
                picture = pictures / f"{claim.picture}.png" if claim.picture and not seed else None
                report = kept.put(claim, seed, run(claim, seed, picture))
            if report is None:
                continue
            outcome.reports.append(report)
            this = ClaimOutcome(claim, [report])
            print(f"{claim.command} --seed {seed}: {this.medians()}; {this.share()}", flush=True)
            # after each run: who has less time has a page of fewer
            there = [outcome for outcome in outcomes if outcome.reports]
            (root / PAGE).write_text(page(there), encoding="utf-8")
    return int(any(any(report["limits"].values()) for outcome in outcomes for report in outcome.reports))


if __name__ == "__main__":
    raise SystemExit(main())
