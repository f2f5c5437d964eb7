"""Run every claim over some seeds and write the page: `python -m deltaq_experiments.claims --seeds 10`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from deltaq_experiments.claims.claim import Claim, ClaimOutcome, JsonReport
from deltaq_experiments.claims.page import page
from deltaq_experiments.claims.table import CLAIMS
from deltaq_experiments.figures import draw
from deltaq_experiments.report import ExperimentOutcome

PAGE = Path("docs/explanation/camera-figures.md")
PICTURES = Path("docs/explanation/pictures")
SEEDS = 10
"""Runs of each claim: enough to tell what is usual from what one seed does."""


def run(claim: Claim, seeds: Sequence[int], pictures: Path) -> ClaimOutcome:
    """The runs of one claim, one for each seed; the picture is drawn of the first.

    Raises:
        DeltaqError: if a run cannot be made.
    """
    module = import_module(f"deltaq_experiments.{claim.experiment}")
    reports: list[JsonReport] = []
    for seed in seeds:
        outcome: ExperimentOutcome = module.run(replace(claim.options, seed=seed))
        if claim.picture and not reports:
            draw(outcome.panels, f"{claim.command} --seed {seed}", pictures / f"{claim.picture}.png")
        reports.append(outcome.report.model_dump(mode="json"))
        of_this = ClaimOutcome(claim, reports[-1:])
        print(f"{claim.command} --seed {seed}: {of_this.medians()}; {of_this.share()}", flush=True)
    return ClaimOutcome(claim, reports)


def main(arguments: Sequence[str] | None = None, claims: Sequence[Claim] = CLAIMS) -> int:
    """Run all of them and write the page; returns 1 if a joint passed a limit."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_experiments.claims", description=__doc__)
    parser.add_argument("--root", type=Path, default=Path(), help="where docs/ lies (default: here)")
    parser.add_argument(
        "--seeds",
        type=int,
        default=SEEDS,
        help="runs of each claim, a minute or less each (default: %(default)s)",
    )
    options = parser.parse_args(arguments)
    seeds: int = options.seeds
    root: Path = options.root
    if seeds < 1:
        parser.error(f"--seeds {seeds}: at least 1")
    (root / PICTURES).mkdir(parents=True, exist_ok=True)
    outcomes = [run(claim, range(seeds), root / PICTURES) for claim in claims]
    (root / PAGE).write_text(page(outcomes, seeds), encoding="utf-8")
    violated = any(any(report["limits"].values()) for outcome in outcomes for report in outcome.reports)
    return int(violated)


if __name__ == "__main__":
    raise SystemExit(main())
