"""Barriers for a robot's next increment, so that it keeps clear before the gate has to stop it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.interface import View
from deltaq_controllers.surroundings.barriers import Barriers, Braking, Keeping, barriers_of
from deltaq_controllers.surroundings.neighbours import NearPairs, Neighbours
from deltaq_controllers.surroundings.setpoints import OtherRobots
from deltaq_protocol.arrays import Array

MOST_PAIRS = 16
"""Pairs of bodies that are taken into account: the nearest in proportion to their range."""

CLEAR_OF_OTHERS_M, CLEAR_OF_STRUCTURE_M, CLEAR_OF_SELF_M = 0.03, 0.01, 0.01
"""Distances that are kept beyond those of the gate [m]."""

RANGE_M, RANGE_OF_OTHERS_M = 0.15, 0.5
"""Distance beyond the least distance within which a pair is considered [m]."""

SHARE, SHARE_OF_OTHERS = 0.05, 0.05
"""Part of the remaining distance that one cycle may use up: a motion that brakes in 39 cycles stops before zero."""

REACTION_S, OTHERS_BRAKE_M_S2 = 0.2, 2.0
"""How long another robot is expected to keep its speed [s], and how hard it brakes then [m/s^2]."""


class Near(NamedTuple):
    """Barriers, and whose they are.

    Attributes:
        barriers: for the next increment.
        pairs: of bodies, of which `barriers.places` tells.
    """

    barriers: Barriers
    pairs: NearPairs


class RobotSurroundings:
    """The bodies of a cell near one robot, its own included.

    Pairs that a contact of the cell names are left to the gate: only it knows whether they may touch.

    Args:
        cell: the cell.
        robot: name of the robot.
    """

    def __init__(self, cell: CellModel, robot: str) -> None:
        self._cycle_s = cell.description.cycle_s
        self._neighbours = Neighbours(cell, robot, MOST_PAIRS)
        self._others = OtherRobots(cell, robot)
        self._here = Braking(np.zeros(cell.robots[robot].n), 1.0)
        pairs, gate = self._neighbours, cell.description.gate
        stop = np.where(pairs.same, gate.self_stop_distance_m, gate.stop_distance_m)
        beyond = np.where(pairs.same, CLEAR_OF_SELF_M, CLEAR_OF_STRUCTURE_M)
        margins = stop + np.where(pairs.foreign, CLEAR_OF_OTHERS_M, beyond)
        ranges = margins + np.where(pairs.foreign, RANGE_OF_OTHERS_M, RANGE_M)
        self._ranges = np.where(_may_touch(cell, pairs.names), -np.inf, ranges)
        shares = np.where(pairs.foreign, SHARE_OF_OTHERS, SHARE)
        self._keeping = Keeping(pairs.foreign, margins, shares, REACTION_S, OTHERS_BRAKE_M_S2)

    def update(self, view: View) -> None:
        """Add an observation of the other robots."""
        self._others.update(view)

    def kept(self, pair: int) -> tuple[tuple[str, str], float]:
        """The names of a pair of bodies, and the distance that is kept between them [m]."""
        return self._neighbours.names[pair], float(self._keeping.margins[pair])

    def near(self, q: Array, slowest: Array, fastest: Array) -> Near:
        """Barriers of all that is in range.

        They are judged where the robot is, not where its brake ends: a self-motion's brake is straight in the joints
        and moves the hands a little, and against that no self-motion helps. `SHARE` leaves room for every brake.

        Args:
            q: (n,) setpoint that the increment is added to [rad or m].
            slowest: (n,) least increment [rad or m].
            fastest: (n,) greatest increment [rad or m].
        """
        near = self._neighbours.near(self._others.joined(q, self._others.ahead()), self._ranges)
        barriers = barriers_of(
            near, self._keeping, self._here, self._others.rates(), slowest, fastest, self._cycle_s
        )
        return Near(barriers, near)


def _may_touch(cell: CellModel, names: tuple[tuple[str, str], ...]) -> NDArray[np.bool_]:
    """(p,) which pairs of bodies a contact of the cell names."""
    contacts = cell.description.contacts.values()
    return np.array(
        [
            any(
                (one in contact.bodies and other in contact.against)
                or (other in contact.bodies and one in contact.against)
                for contact in contacts
            )
            for one, other in names
        ],
        dtype=np.bool_,
    )
