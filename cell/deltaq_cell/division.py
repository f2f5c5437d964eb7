"""What the kernel answers when it has divided tubes for one list of pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from deltaq_cell.group import Group, Nearest


@dataclass(frozen=True)
class Division:
    """What came of dividing tubes.

    Attributes:
        holds: whether every pair keeps what is asked anywhere in them.
        left: what is left of the budget.
        tightest: the pair with the least room, in the first look or in that which failed; None if there are none.
        stop_distance_m: of that pair [m].
        failing: the pairs that were left open where it failed; none if it holds.
    """

    holds: bool
    left: int
    tightest: Nearest | None
    stop_distance_m: float
    failing: Sequence[Group]
