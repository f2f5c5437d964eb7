"""The page of claims: a table with a row for each, and the pictures of the first seed."""

from __future__ import annotations

from collections.abc import Sequence

from deltaq_experiments.claims.claim import ClaimOutcome


def page(outcomes: Sequence[ClaimOutcome], seeds: int) -> str:
    """The page.

    Args:
        outcomes: of all claims.
        seeds: how many runs each has.
    """
    last = seeds - 1
    which = f"a run for each `--seed` from 0 to {last}" if last else "one run, `--seed 0`"
    lines = [
        "# The paper's figures, and ours",
        "",
        f"Written by `make figures`, `python -m deltaq_experiments.claims --seeds {seeds}`. Of each row {which}: the",
        "median of the runs, the worst with its seed, and in how many of them the claim holds. Virtual time, 12 ms",
        "cycle, 60 ms latency, leader at 0.25 m/s unless said otherwise; each figure is the largest of its run after",
        "`--settle-s`, 5 s if it is not there. The pictures are of seed 0.",
        "[The camera follower](camera-follower.md) explains what the controllers do.",
        "",
        "| run | claimed | median | worst (seed) | holds |",
        "| --- | --- | --- | --- | --- |",
    ]
    for outcome in outcomes:
        claim = outcome.claim
        cells = (f"`{claim.command}`", claim.claim, outcome.medians(), outcome.worst(), outcome.share())
        lines.append(f"| {' | '.join(cells)} |")
    for outcome in outcomes:
        claim = outcome.claim
        if claim.picture:
            lines += ["", f"![{claim.claim}](pictures/{claim.picture}.png)", "", f"`{claim.command}`"]
    return "\n".join(lines) + "\n"
