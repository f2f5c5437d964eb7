"""Groups of bodies whose distances coal measures in one call, with one stop distance for all pairs."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.kernel.arrays import Integers, Pairs
from deltaq_protocol.arrays import Array, Flags

Names = frozenset[frozenset[str]]


@dataclass(frozen=True)
class Nearest:
    """The pair of a group with the least swept distance.

    Attributes:
        pair: names of the two bodies.
        swept_m: lower bound of their distance over the box in joint space.
        distance_m: their distance at the middle of the box.
        points_m: witness points in world coordinates.
    """

    pair: tuple[str, str]
    swept_m: float
    distance_m: float
    points_m: tuple[Array, Array]


class Group:
    """Bodies that move as one, the bodies that they are checked against, and one stop distance for all pairs.

    Args:
        bodies: pinocchio geometry objects on one link.
        against: the bodies on the other side.
        never: pairs of names that are left out.
        stop_distance_m: the distance that all pairs have to keep.

    Attributes:
        pairs: the bodies of each.
        active: (pairs,) whether each is measured now, False for those that were left out.
        stop_distance_m: as given.
    """

    def __init__(
        self, bodies: Sequence[Any], against: Sequence[Any], never: Names, stop_distance_m: float
    ) -> None:
        self.stop_distance_m = stop_distance_m
        self.pairs: list[tuple[Any, Any]] = [
            (first, second)
            for first in bodies
            for second in against
            if frozenset((first.name, second.name)) not in never
        ]
        self.active: Flags = np.ones(len(self.pairs), dtype=bool)

    @cached_property
    def _coal(self) -> tuple[Any, Any]:
        """Geometry model and data for coal, made at first use: if the kernel measures, they are never made."""
        geometry = pin.GeometryModel()
        index: dict[str, int] = {}
        for pair in self.pairs:
            for body in pair:
                if body.name not in index:
                    index[body.name] = geometry.addGeometryObject(body)
            geometry.addCollisionPair(pin.CollisionPair(*(index[body.name] for body in pair)))
        data = geometry.createData()
        make_reproducible(data)
        for left_out in np.flatnonzero(~self.active).tolist():
            data.deactivateCollisionPair(left_out)
        return geometry, data

    def least(self, model: Any, data: Any) -> float:
        """Least swept distance [m] at the placement that `data` holds."""
        geometry, placed = self._coal
        pin.updateGeometryPlacements(model, data, geometry, placed)
        self._least = pin.computeDistances(geometry, placed)
        distance: float = placed.distanceResults[self._least].min_distance
        return distance

    def nearest(self) -> Nearest:
        """The pair that `least` found last."""
        return self._measured(self._least)

    @property
    def is_empty(self) -> bool:
        """Whether every pair has been left out."""
        return not self.active.any()

    def leave_out(self, index: int) -> None:
        """Measure a pair no longer."""
        self.active[index] = False
        if "_coal" in self.__dict__:
            self._coal[1].deactivateCollisionPair(index)

    def take_in(self, index: int) -> None:
        """Measure a pair again."""
        self.active[index] = True
        if "_coal" in self.__dict__:
            self._coal[1].activateCollisionPair(index)

    def measured(self) -> dict[int, Nearest]:
        """Every pair that is not left out, by index, as `least` measured it; slower than `nearest`."""
        return {index: self._measured(index) for index in np.flatnonzero(self.active).tolist()}

    def nearer(self, distance_m: float) -> list[int]:
        """Indices of the pairs whose swept distance is below `distance_m`, as `least` measured them."""
        results = self._coal[1].distanceResults
        active = np.flatnonzero(self.active).tolist()
        return [index for index in active if results[index].min_distance < distance_m]

    def _measured(self, index: int) -> Nearest:
        first, second = self.pairs[index]
        result = self._coal[1].distanceResults[index]
        swept: float = result.min_distance
        radii = first.geometry.getSweptSphereRadius() + second.geometry.getSweptSphereRadius()
        points = (np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2()))
        return Nearest((first.name, second.name), swept, swept + radii, points)


def make_reproducible(data: Any) -> None:
    """Make distances depend only on the bodies and their poses.

    It switches off GJK's cached guess, which makes a distance depend on earlier queries. And coal's support function
    of a box remembers whether its first direction had a zero component, and then enlarges boxes by 1e-10 of their
    size. A first call without zeros prevents that.
    """
    _ask_boxes_for_a_slanting_direction()
    with warnings.catch_warnings():
        # coal deprecates the switch in favour of the initial guess, but still obeys it
        warnings.simplefilter("ignore", DeprecationWarning)
        for request in data.distanceRequests:
            request.gjk_initial_guess = coal.GJKInitialGuess.DefaultGuess
            request.enable_cached_gjk_guess = False


@cache
def _ask_boxes_for_a_slanting_direction() -> None:
    request = coal.DistanceRequest()
    request.gjk_initial_guess, request.cached_gjk_guess = coal.GJKInitialGuess.CachedGuess, np.ones(3)
    box, beside = coal.Box(1.0, 1.0, 1.0), coal.Transform3s(np.eye(3), np.full(3, 3.0))
    coal.distance(box, coal.Transform3s.Identity(), box, beside, request, coal.DistanceResult())


class PairedGroups(list[Group]):
    """Groups with their pairs to be checked; immutable.

    Attributes:
        numbers: (pairs,) index of each pair among all pairs.
        group: (pairs,) index of the group that each belongs to, in `of`.
        pairs: the same pairs in the kernel's form.
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
    """A list of some pairs, without the other pairs of their groups."""
    first, second, stop_m, active = listed.pairs
    pairs = Pairs(first[open_], second[open_], stop_m[open_], active[open_])
    return PairedGroups([], listed.numbers[open_], listed.group[open_], pairs, listed.of)


def part_of(listed: PairedGroups, open_: Integers) -> PairedGroups:
    """A list of the groups of some pairs, each with all its pairs."""
    failing = np.zeros(len(listed.of), dtype=bool)
    failing[listed.group[open_]] = True
    groups = [listed.of[index] for index in np.flatnonzero(failing).tolist()]
    pairs = listed.pairs._replace(active=listed.pairs.active & failing[listed.group])
    return PairedGroups(groups, listed.numbers, listed.group, pairs, listed.of)
