"""Clearance by the exact shapes that the gate uses, for what is shown to people and driven."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import Group
from deltaq_cell.proximity import Proximity
from deltaq_cell.screen import ScreenedGroups

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Clearance:
    """The tightest pair of one configuration.

    Attributes:
        room_m: distance beyond the stop distance; negative is too near.
        distance_m: distance.
        pair: names of the two bodies.
    """

    room_m: float
    distance_m: float
    pair: tuple[str, str]


class ExactClearance:
    """Measures one robot of a cell, the others standing still.

    Args:
        cell: model of the cell.
        robot: name of the robot.
        others: (n,) configuration of each other robot; at home if not given.
    """

    def __init__(self, cell: CellModel, robot: str, others: Mapping[str, Array] | None = None) -> None:
        self._proximity = Proximity(cell)
        self._robot = robot
        lists = [self._proximity.alone[robot]]
        lists += [self._proximity.between[robot, name] for name in cell.robots if name != robot]
        self._lists = [groups for groups in lists if isinstance(groups, ScreenedGroups) and groups]
        self.place({name: model.home for name, model in cell.robots.items()} | dict(others or {}))

    def place(self, others: Mapping[str, Array]) -> None:
        """Place other robots, each at its configuration (n,)."""
        for name, q in others.items():
            if name != self._robot:
                self._proximity.place(name, q, np.zeros(len(q)))

    def is_clear(self, q: Array) -> bool:
        """Whether all configurations (N, n) keep more than the stop distance."""
        return all(map(self._is_clear, q))

    def _is_clear(self, q: Array) -> bool:
        self._proximity.place(self._robot, q, np.zeros(len(q)))
        return all(self._proximity.least(group) > group.stop_distance_m for group in self._doubtful())

    def _doubtful(self) -> Iterator[Group]:
        """Groups of bodies that are not seen from afar to be clear."""
        for groups in self._lists:
            for index in np.flatnonzero(groups.screen.rooms() <= 0.0):
                if not groups[index].is_empty:
                    yield groups[index]

    def measure(self, q: Array) -> Clearance:
        """The tightest pair at configuration `q` (n,)."""
        self._proximity.place(self._robot, q, np.zeros(len(q)))
        looks = [self._proximity.look(groups, 0.0) for groups in self._lists]
        rooms = [(near.swept_m - look.stop_distance_m, near) for look in looks if (near := look.tightest)]
        room_m, near = min(rooms, key=lambda item: item[0])
        return Clearance(room_m, near.distance_m, near.pair)
