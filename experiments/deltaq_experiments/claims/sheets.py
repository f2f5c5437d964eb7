"""The pages of claims: what is on each, and what it says above its table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from deltaq_experiments.claims.attacks import ATTACKS
from deltaq_experiments.claims.claim import Claim
from deltaq_experiments.claims.table import CLAIMS


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
    Path("docs/explanation/camera-figures.md"),
    "The paper's figures, and ours",
    (
        "Virtual time, 12 ms cycle, 60 ms latency, leader asked for 0.25 m/s unless said otherwise; each figure is",
        "the largest of its run after `--settle-s`, 5 s if it is not there. `leader's mean` and `peak` are the speeds",
        "that its tool reached, whatever it was asked for. The pictures are of seed 0.",
        "[The camera follower](camera-follower.md) explains what the controllers do;",
        "[under attack](attack-figures.md) they have a page of their own.",
    ),
    CLAIMS,
)

ATTACK = Sheet(
    "attack",
    Path("docs/explanation/attack-figures.md"),
    "The camera follower under attack",
    (
        "Virtual time, 12 ms cycle, 60 ms latency, leader asked for 0.25 m/s unless said otherwise. Where both robots",
        "stand at the beginning, and where the leader comes from after each attack, is drawn from the seed; figures",
        "begin after `--settle-s`. `attacker free` is the share of the attacking cycles in which the leader's tool",
        "moved as it wanted to, and was not held by the gate or by its own limits; `follower held` that of the",
        "follower's verdicts that held or refused it. `--json` tells the speed that the leader's tool reached, mean",
        "and peak (`leader_reached_m_s`). `lab-open` is the lab without the plant's panel, on which the leader jams in",
        "the lab; `lab-aside` has the follower elsewhere besides.",
        "[The camera follower](camera-follower.md#where-it-ends) says what limits them.",
    ),
    ATTACKS,
)

SHEETS = (CAMERA, ATTACK)
