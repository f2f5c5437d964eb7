"""Clearance by the exact shapes that the gate uses, for what is shown to people and driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_cell.proximity import Proximity

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
        self._lists = [self._proximity.alone[robot]]
        self._lists += [self._proximity.between[robot, name] for name in cell.robots if name != robot]
        self.place({name: model.home for name, model in cell.robots.items()} | dict(others or {}))

    def place(self, others: Mapping[str, Array]) -> None:
        """Place other robots, each at its configuration (n,)."""
        for name, q in others.items():
            if name != self._robot:
                self._proximity.place(name, q, np.zeros(len(q)))

    def measure(self, q: Array) -> Clearance:
        """The tightest pair at configuration `q` (n,)."""
        self._proximity.place(self._robot, q, np.zeros(len(q)))
        looks = [self._proximity.look(groups, 0.0) for groups in self._lists if groups]
        rooms = [(near.swept_m - look.stop_distance_m, near) for look in looks if (near := look.tightest)]
        room_m, near = min(rooms, key=lambda item: item[0])
        return Clearance(room_m, near.distance_m, near.pair)
