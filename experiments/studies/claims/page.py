"""The page of claims: a table with a row for each, and the pictures of the first seed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from studies.claims.claim import Claim, ClaimOutcome
from studies.claims.table import ATTACKS, CLAIMS


@dataclass(frozen=True)
class Sheet:
    """A page.

    Attributes:
        name: by which it is asked for.
        file: where it is written, under the project's root.
        title: of the page.
        about: what a reader has to know before the table, a line each.
        claims: rows of the table.
    """

    name: str
    file: Path
    title: str
    about: tuple[str, ...]
    claims: tuple[Claim, ...]


CAMERA = Sheet(
    "camera",
    Path("docs/notes/camera-figures.md"),
    "The paper's figures, and ours",
    (
        "The runs are in virtual time, with a cycle of 12 ms, drives that lag 120 ms and, unless the command says",
        "otherwise, a leader that is asked for 0.25 m/s. Each figure is the largest of its run after `--settle-s`",
        "(5 s if not given). `leader's mean` and `peak` are the speeds that its tool reached. The pictures are of",
        "seed 0. [The camera follower](../explanation/camera-follower.md) explains the controllers; their figures",
        "[under attack](attack-figures.md) are on a page of their own.",
    ),
    CLAIMS,
)

ATTACK = Sheet(
    "attack",
    Path("docs/notes/attack-figures.md"),
    "The camera follower under attack",
    (
        "The runs are in virtual time, with a cycle of 12 ms, drives that lag 120 ms and, unless the command says",
        "otherwise, a leader that is asked for 0.25 m/s. The seed determines where both robots stand at the",
        "beginning, and from where the leader comes after each attack. Figures begin after `--settle-s`.",
        "`attacker free` is the fraction of the attacking cycles in which the leader's tool moved as requested, and",
        "was not held by the gate or by its own limits. `follower held` is the fraction of the follower's verdicts",
        "that were `held` or `refused`. `leader's mean` and `peak` are the speeds that the leader's tool reached.",
        "`lab-open` is the lab without the plant's panel, which stops the leader in the lab; in `lab-aside` the",
        "follower also stands elsewhere.",
        "[The camera follower](../explanation/camera-follower.md#limits) says what limits the controllers.",
    ),
    ATTACKS,
)

SHEETS = (CAMERA, ATTACK)


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
