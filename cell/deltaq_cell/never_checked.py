"""Pairs of one robot's bodies that are never checked against each other, and why.

Bodies of links that are fixed to one another, or that one joint joins, touch by construction. So do others in
every public URDF: hulls that overlap at home and wherever the joints are. They are found by sampling, as in
MoveIt's setup assistant. Pairs that never touch in the samples are checked all the same: a
sample proves nothing about the configurations between the samples.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations, product
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from deltaq_cell.description import RobotDescription
from deltaq_cell.group import make_reproducible
from deltaq_cell.models import RobotModelError, nearest_name
from deltaq_protocol.arrays import Array

Pair: TypeAlias = tuple[str, str]

SAMPLES = 1000
"""Configurations in which a pair has to touch, besides home."""

FEW = 20
"""Of these, as many are looked at first."""

MOST_ALWAYS_TOUCHING = (3, 0.25)
"""As many pairs as the first, and a greater share of those that could be checked than the second, are no robot's; of
public robots at most 9 % always touch."""

PLACES = 121
"""Positions of a joint, limits included, at which the bodies that it joins are measured."""

NOTICED_M = 0.001
"""Bodies that one joint joins overlap or are apart by more than this, or they touch all along, as hinges do."""


class Why(StrEnum):
    """Why a pair of bodies is never checked."""

    ONE_LINK = "they are on one link, or on links that are fixed to one another"
    ADJACENT = "one joint joins their links"
    MOUNTED = "the robot is mounted on it"
    NAMED = "the cell names them in never_checked"
    ALWAYS_TOUCH = f"they touch at home and at each of {SAMPLES} configurations drawn within the joint limits"


def ordered(first: str, second: str) -> Pair:
    """A pair of names in the order in which pairs are listed."""
    return (first, second) if first <= second else (second, first)


def never_checked(
    model: Any,
    bodies: Sequence[Any],
    links: Mapping[str, Sequence[str]],
    description: RobotDescription,
    robot: str,
) -> dict[Pair, Why]:
    """Pairs of body names that are never checked, and why.

    The robot's mount are its bodies that stand still or, if none does (a portal on rails), those that the first
    joint moves.

    Args:
        model: pinocchio's, in which the bodies are.
        bodies: pinocchio geometry objects of the robot.
        links: names of each link's bodies, without the robot's.
        description: of the robot.
        robot: its name, with which the bodies' names begin.

    Raises:
        RobotModelError: the description names a body that the robot does not have, or most bodies always touch.
    """
    pairs = joined_pairs(model, bodies)
    own = [body.name.removeprefix(f"{robot}/") for body in bodies]
    for index, names in enumerate(description.never_checked):
        first, second = (
            [f"{robot}/{body}" for body in _named(name, own, links, robot, (index, side))]
            for side, name in enumerate(names)
        )
        for pair in product(first, second):
            pairs[ordered(*pair)] = Why.NAMED
    touching = always_touching(model, bodies, pairs, description.home, description.lower, description.upper)
    _check_share(touching, len(bodies) * (len(bodies) - 1) // 2 - len(pairs))
    pairs |= touching
    mount = min((int(body.parentJoint) for body in bodies), default=0)
    for body in bodies:
        if body.parentJoint == mount:
            for name in description.mounted_on:
                pairs[ordered(body.name, f"structure/{name}")] = Why.MOUNTED
    return pairs


def joined_pairs(model: Any, bodies: Sequence[Any]) -> dict[Pair, Why]:
    """Pairs of bodies on one link, or on two links that one joint joins."""
    found = {}
    for first, second in combinations(bodies, 2):
        low, high = sorted((int(first.parentJoint), int(second.parentJoint)))
        if low == high:
            found[ordered(first.name, second.name)] = Why.ONE_LINK
        elif int(model.parents[high]) == low:
            found[ordered(first.name, second.name)] = Why.ADJACENT
    return found


@dataclass(frozen=True)
class Overlap:
    """Two bodies that one joint joins, and that overlap at some of its positions only.

    Attributes:
        pair: their names.
        joint: index of the joint.
        ranges: positions of the joint at which they overlap, from and to [rad or m].
        depth_m: the greatest overlap.
    """

    pair: Pair
    joint: int
    ranges: tuple[tuple[float, float], ...]
    depth_m: float


def overlaps_in_part(
    model: Any, bodies: Sequence[Any], adjacent: Iterable[Pair], home: Array, lower: Array, upper: Array
) -> Iterator[Overlap]:
    """Bodies that one joint joins, which the gate presumes safe, and that overlap at some of its positions only.

    Args:
        model: pinocchio's, in which the bodies are.
        bodies: pinocchio geometry objects of one robot.
        adjacent: names of the pairs that one joint joins.
        home: (n,) configuration of the other joints.
        lower: (n,) limits of the joints.
        upper: likewise.
    """
    carried = {body.name: int(body.parentJoint) for body in bodies}
    adjacent = list(adjacent)
    for joint in range(len(home)):
        pairs = [pair for pair in adjacent if max(carried[name] for name in pair) == joint + 1]
        places = np.linspace(lower[joint], upper[joint], PLACES)
        configurations = np.tile(home, (PLACES, 1))
        configurations[:, joint] = places
        for pair, apart in zip(pairs, distances(model, bodies, pairs, configurations).T, strict=True):
            if apart.min() < -NOTICED_M and apart.max() > NOTICED_M:
                edges = np.flatnonzero(np.diff(np.concatenate([[False], apart < 0.0, [False]]).astype(int)))
                ranges = tuple((float(places[a]), float(places[b - 1])) for a, b in edges.reshape(-1, 2))
                yield Overlap(pair, joint, ranges, float(-apart.min()))


def distances(
    model: Any, bodies: Sequence[Any], pairs: Sequence[Pair], configurations: Iterable[Array]
) -> Array:
    """(configurations, pairs) distances of pairs of bodies, negative where they overlap [m]."""
    geometry = pin.GeometryModel()
    index = {body.name: geometry.addGeometryObject(body) for body in bodies}
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(index[first], index[second]))
    data, geometry_data = model.createData(), geometry.createData()
    make_reproducible(geometry_data)
    rows = []
    for q in configurations:
        pin.updateGeometryPlacements(model, data, geometry, geometry_data, q)
        rows.append([pin.computeDistance(geometry, geometry_data, k).min_distance for k in range(len(pairs))])
    return np.array(rows)


def always_touching(
    model: Any, bodies: Sequence[Any], left_out: Iterable[Pair], home: Array, lower: Array, upper: Array
) -> dict[Pair, Why]:
    """Pairs that touch at home and at every sample within the joint limits.

    Args:
        model: pinocchio's, in which the bodies are.
        bodies: pinocchio geometry objects of one robot.
        left_out: pairs that are not checked anyway.
        home: (n,) configuration.
        lower: (n,) limits of the joints.
        upper: likewise.
    """
    known = set(left_out)
    pairs = [ordered(one.name, other.name) for one, other in combinations(bodies, 2)]
    touching = [pair for pair in pairs if pair not in known]
    drawn = samples(lower, upper)
    # the usual case is links apart at home, and then no sample is needed; a few samples part most of the others
    for configurations in ([home], drawn[:FEW], drawn[FEW:]):
        if touching:
            apart = distances(model, bodies, touching, configurations).max(axis=0)
            touching = [pair for pair, most in zip(touching, apart, strict=True) if most <= 0.0]
    return dict.fromkeys(touching, Why.ALWAYS_TOUCH)


def _check_share(touching: Iterable[Pair], checkable: int) -> None:
    """Refuse a robot of which hardly a pair would be checked.

    Raises:
        RobotModelError: too many pairs always touch; the error names the body that is in most of them.
    """
    names = [name for pair in touching for name in pair]
    count, (least, share) = len(names) // 2, MOST_ALWAYS_TOUCHING
    if count >= least and count > share * checkable:
        most = max(names, key=names.count)
        raise RobotModelError(
            f"{count} of {checkable} pairs of bodies touch wherever the joints are, and would never be checked; body "
            f"'{most}' is in most of them: is it too large, or its mesh in other units? "
            "If they are correct, name the pairs in never_checked",
            ("model",),
        )


def _named(
    name: str, own: list[str], links: Mapping[str, Sequence[str]], robot: str, place: tuple[int, int]
) -> list[str]:
    """The bodies that a name in `never_checked` means: one body, or all of a link."""
    found = [body for body in own if body == name or body in links.get(name, ())]
    if not found:
        raise RobotModelError(
            f"robot '{robot}' has no body '{name}', and no link of that name with one; it has {', '.join(own)}",
            ("never_checked", *map(str, place)),
            nearest_name(name, own),
        )
    return found


def samples(lower: Array, upper: Array) -> Array:
    """(`SAMPLES`, n) configurations within the limits, from a fixed seed."""
    return np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))
