"""Numbers that are only compared, by what comparing tells."""

from __future__ import annotations

from collections.abc import Sequence


def ranks(numbers: Sequence[int], apart: int) -> dict[int, int]:
    """Numbers by their order and their distance, distances above `apart` taken for equal."""
    ranks: dict[int, int] = {}
    rank, last = 0, None
    for number in sorted(set(numbers)):
        rank += 0 if last is None else min(number - last, apart)
        ranks[number] = rank
        last = number
    return ranks
