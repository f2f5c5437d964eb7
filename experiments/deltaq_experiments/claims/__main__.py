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
    of_this = ClaimOutcome(claim, [report])
    print(f"{claim.command} --seed {seed}: {of_this.medians()}; {of_this.share()}", flush=True)
    return report


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
    pictures = root / PICTURES
    pictures.mkdir(parents=True, exist_ok=True)
    reports: list[list[JsonReport]] = [[] for _ in claims]
    for seed in range(seeds):
        for claim, so_far in zip(claims, reports, strict=True):
            picture = pictures / f"{claim.picture}.png" if claim.picture and not seed else None
            so_far.append(run(claim, seed, picture))
        # after each seed: who has less time has a page of fewer
        outcomes = [ClaimOutcome(claim, so_far) for claim, so_far in zip(claims, reports, strict=True)]
        (root / PAGE).write_text(page(outcomes, seed + 1), encoding="utf-8")
    return int(any(any(report["limits"].values()) for so_far in reports for report in so_far))


if __name__ == "__main__":
    raise SystemExit(main())
