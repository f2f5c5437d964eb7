"""Run every claim over some seeds and write the pages: `python -m studies.claims --seeds 10`."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from deltaq_deploy.launch.program import run_program
from deltaq_experiments.figures import draw
from deltaq_experiments.report import ExperimentOutcome
from studies.claims.claim import Claim, ClaimOutcome, JsonReport, KeptReports
from studies.claims.page import ENOUGH, SHEETS, Sheet, page

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


def main(arguments: Sequence[str] | None = None, sheets: Sequence[Sheet] = SHEETS) -> int:
    """Run all of them and write the pages; returns 1 if a joint passed a limit."""
    parser = argparse.ArgumentParser(prog="python -m studies.claims", description=__doc__)
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
    names = [sheet.name for sheet in sheets]
    parser.add_argument("--page", choices=names, default=None, help="write only this page (default: all)")
    options = parser.parse_args(arguments)
    if options.seeds < 1:
        parser.error(f"--seeds {options.seeds}: at least 1")
    chosen = [sheet for sheet in sheets if options.page in (None, sheet.name)]
    if not any(options.only in claim.command for sheet in chosen for claim in sheet.claims):
        parser.error(f"--only {options.only!r}: no claim has this in its command")
    for folder in (PICTURES, *(sheet.file.parent for sheet in chosen)):
        (options.root / folder).mkdir(parents=True, exist_ok=True)
    kept = KeptReports(options.reports)
    passed = [_write(sheet, kept, options.root, options.seeds, options.only) for sheet in chosen]
    return int(not all(passed))


def _write(sheet: Sheet, kept: KeptReports, root: Path, seeds: int, only: str) -> bool:
    """Run a page's claims, and write it after each run; tells whether no joint passed a limit."""
    outcomes = [ClaimOutcome(claim, []) for claim in sheet.claims]
    for seed in range(seeds):
        for outcome in outcomes:
            claim = outcome.claim
            report = kept.get(claim, seed)
            if report is None and only in claim.command:
                picture = root / PICTURES / f"{claim.picture}.png" if claim.picture and not seed else None
                report = kept.put(claim, seed, run(claim, seed, picture))
            if report is None:
                continue
            outcome.reports.append(report)
            this = ClaimOutcome(claim, [report])
            print(f"{claim.command} --seed {seed}: {this.medians()}; {this.share()}", flush=True)
            # after each run: who has less time has a page of fewer
            there = [outcome for outcome in outcomes if outcome.reports]
            (root / sheet.file).write_text(page(sheet, there), encoding="utf-8")
    return not any(any(report["limits"].values()) for outcome in outcomes for report in outcome.reports)


if __name__ == "__main__":
    run_program(main, "studies.claims")
