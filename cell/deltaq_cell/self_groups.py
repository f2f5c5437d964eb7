"""The bodies of one robot against each other."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import Bodies
from deltaq_cell.broad_phase import Surroundings
from deltaq_cell.group import Group, Names
from deltaq_protocol.arrays import Array


class SelfGroups:
    """Links of a robot against each other: only joints that move one and not the other make them travel.

    The bodies are clones, since their radii differ from the ones against the rest of the world.

    Attributes:
        groups: one for each two links that are checked.
    """

    def __init__(
        self, bodies: Bodies, never: Names, stop_distance_m: float, surroundings: Surroundings
    ) -> None:
        self.groups: list[Group] = []
        self._around = surroundings
        self._clones: list[Any] = []
        self._sources: list[int] = []
        joints = []
        for inner, outer in combinations(bodies.links, 2):
            clones = {index: _clone(bodies.objects[index]) for index in (*outer, *inner)}
            group = Group([clones[i] for i in outer], [clones[i] for i in inner], never, stop_distance_m)
            if not group.pairs:
                continue
            self.groups.append(group)
            for mine, theirs in ((outer, inner), (inner, outer)):
                self._clones += [clones[i] for i in mine]
                self._sources += mine
                joints += [bodies.moved_by[mine[0]] & ~bodies.moved_by[theirs[0]]] * len(mine)
        self._shapes = [clone.geometry for clone in self._clones]
        self._joints = np.array(joints).reshape(len(joints), bodies.moved_by.shape[1])
        self._places = surroundings.add_moving(self._clones, bodies.radii[self._sources])

    def inflate(self, travel: Array, centres: Array) -> None:
        """Inflate the clones by their share of `travel`, (bodies, n) [m], around `centres` (bodies, 3) [m]."""
        radii = (travel[self._sources] * self._joints).sum(axis=1)
        self._around.centre[self._places] = centres[self._sources]
        self._around.inflation[self._places] = radii
        for shape, radius in zip(self._shapes, radii.tolist(), strict=True):
            shape.setSweptSphereRadius(radius)


def _clone(item: Any) -> Any:
    return pin.GeometryObject(item.name, item.parentJoint, item.placement, item.geometry.clone())
