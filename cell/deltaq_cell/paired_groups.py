"""Groups with their pairs as the kernel takes them, and parts of such lists."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deltaq_cell.group import Group
from deltaq_cell.kernel.arrays import Integers, Pairs


class PairedGroups(list[Group]):
    """Groups with the pairs of them that are to be looked at; not to be changed.

    Attributes:
        numbers: (pairs,) of the pairs among all.
        group: (pairs,) index of the group that each belongs to, in `of`.
        pairs: what the kernel is given.
        of: the groups of the pairs; a group that was not given has no active pair.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        numbers: Integers,
        group: Integers,
        pairs: Pairs,
        of: Sequence[Group] | None = None,
    ) -> None:
        super().__init__(groups)
        self.numbers, self.group, self.pairs = numbers, group, pairs
        self.of = self if of is None else of


def pairs_alone(listed: PairedGroups, open_: Integers) -> PairedGroups:
    """Some pairs of a list, without the others of their groups."""
    first, second, stop_m, active = listed.pairs
    pairs = Pairs(first[open_], second[open_], stop_m[open_], active[open_])
    return PairedGroups([], listed.numbers[open_], listed.group[open_], pairs, listed.of)


def part_of(listed: PairedGroups, open_: Integers) -> PairedGroups:
    """The groups of some pairs of a list, each with all its pairs."""
    failing = np.zeros(len(listed.of), dtype=bool)
    failing[listed.group[open_]] = True
    groups = [listed.of[index] for index in np.flatnonzero(failing).tolist()]
    pairs = listed.pairs._replace(active=listed.pairs.active & failing[listed.group])
    return PairedGroups(groups, listed.numbers, listed.group, pairs, listed.of)
