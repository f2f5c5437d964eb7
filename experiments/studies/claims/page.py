"""The page of claims: a table with a row for each, and the pictures of the first seed."""

from __future__ import annotations

from collections.abc import Sequence

from studies.claims.claim import ClaimOutcome
from studies.claims.sheets import Sheet

ENOUGH = 10
"""Runs that tell what is usual from what one seed does."""


def page(sheet: Sheet, outcomes: Sequence[ClaimOutcome]) -> str:
    """A page of some outcomes, each of one run or more."""
    counts = sorted({len(outcome.reports) for outcome in outcomes})
    runs = (
        f"{counts[0]} to {counts[-1]} runs" if len(counts) > 1 else f"{counts[0]} run{'s'[: counts[0] - 1]}"
    )
    lines = [
        f"# {sheet.title}",
        "",
        "`make figures` writes this page (`python -m studies.claims`).",
        f"Each row has {runs}, from `--seed 0` on. It gives the median and the worst of each figure, the worst",
        "with its seed, and the number of runs in which the claim holds.",
        *sheet.about,
        "",
        "| run | claimed | median | worst (seed) | holds |",
        "| --- | --- | --- | --- | --- |",
    ]
    if counts[0] < ENOUGH:
        lines[-3:-3] = [
            "",
            f"Where a row has fewer than {ENOUGH} runs, there was no time for more; `make figures` makes {ENOUGH}.",
        ]
    for outcome in outcomes:
        claim = outcome.claim
        cells = (f"`{claim.command}`", claim.claim, outcome.medians(), outcome.worst(), outcome.share())
        lines.append(f"| {' | '.join(cells)} |")
    for outcome in outcomes:
        claim = outcome.claim
        if claim.picture:
            lines += [
                "",
                f"![{claim.claim}](../explanation/pictures/{claim.picture}.png)",
                "",
                f"`{claim.command}`",
            ]
    return "\n".join(lines) + "\n"
