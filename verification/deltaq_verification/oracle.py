"""An independent oracle: how near bodies really came, and whether a limit was passed.

It shares nothing with the gate but the bodies and the kinematics: every recorded configuration is placed as it
is and every pair that can be nearest is measured; nothing is inflated. Limits are judged on the emulated controller's
record of its own setpoints, not on what a service intended to send.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array, Indices
from deltaq_verification.counts import LimitCounts
from deltaq_verification.pair_distances import PairDistances

STRUCTURE = "structure"
"""Owner of the bodies that stand still."""


@dataclass(frozen=True)
class LeastDistance:
    """Least distance [m] over some configurations, and between which bodies."""

    distance_m: float
    pair: tuple[str, str]


class ClearanceOracle:
    """Measures every pair of bodies of a cell at given configurations.

    Args:
        cell: the cell.

    Attributes:
        stop_distances_m: (pairs,) what each pair has to keep.
    """

    def __init__(self, cell: CellModel) -> None:
        self._names: list[str] = []
        owners: list[str] = []
        for owner, bodies in [
            *((name, robot.geometry.geometryObjects) for name, robot in cell.robots.items()),
            (STRUCTURE, cell.structure),
        ]:
            self._names += [body.name for body in bodies]
            owners += [owner] * len(bodies)
        never = {frozenset(p) for robot in cell.robots.values() for p in robot.never_checked_pairs()}
        self._pairs = [
            (one, other)
            for one, other in combinations(range(len(owners)), 2)
            if owners[one] != STRUCTURE and frozenset((self._names[one], self._names[other])) not in never
        ]
        self._numbers = {
            frozenset((self._names[one], self._names[other])): number
            for number, (one, other) in enumerate(self._pairs)
        }
        self._distances = PairDistances(cell.robots, cell.structure, self._pairs)
        owned_by = np.array([(owners[one], owners[other]) for one, other in self._pairs]).reshape(-1, 2)
        own = owned_by[:, 0] == owned_by[:, 1]
        self._all = np.arange(len(self._pairs))
        self._own, self._foreign = self._all[own], self._all[~own]
        self._of_two_robots = self._all[~own & (owned_by[:, 1] != STRUCTURE)]
        gate = cell.description.gate
        self.stop_distances_m: Array = np.where(own, gate.self_stop_distance_m, gate.stop_distance_m)

    def between_robots_and_structure(self, configurations: Mapping[str, Array]) -> LeastDistance:
        """Least distance between robots, and between robots and structure; (n,) [rad or m] per robot."""
        return self._nearest(self._foreign, configurations)

    def between_robots(self, configurations: Mapping[str, Array]) -> LeastDistance:
        """Least distance between bodies of two robots; (n,) [rad or m] per robot."""
        return self._nearest(self._of_two_robots, configurations)

    def of_one_robot(self, configurations: Mapping[str, Array]) -> LeastDistance:
        """Least distance between two bodies of one robot; (n,) [rad or m] per robot."""
        return self._nearest(self._own, configurations)

    def of_pair(self, pair: tuple[str, str], configurations: Mapping[str, Array]) -> float:
        """Distance of one pair [m], by the names of its bodies in any order; (n,) [rad or m] per robot.

        Raises:
            KeyError: if the cell checks no such pair.
        """
        self._distances.place(configurations)
        return self._distances.least(self._all[self._numbers[frozenset(pair)], None])[0]

    def least_room_m(self, configurations: Mapping[str, Array], levels_m: Array) -> float:
        """Least that a pair has beyond its level, of all pairs; infinite if there are none.

        Args:
            configurations: (n,) [rad or m] per robot.
            levels_m: (pairs,) distances that are compared with.
        """
        self._distances.place(configurations)
        return self._distances.least(self._all, levels_m)[0]

    def distances_m(self, configurations: Mapping[str, Array], limits_m: Array) -> Array:
        """(pairs,) distance of every pair that is nearer than its limit; of others a bound no less than that.

        Args:
            configurations: (n,) [rad or m] per robot.
            limits_m: (pairs,) distances beyond which nobody asks.
        """
        self._distances.place(configurations)
        return self._distances.below(limits_m)

    def _nearest(self, pairs: Indices, configurations: Mapping[str, Array]) -> LeastDistance:
        self._distances.place(configurations)
        distance, nearest = self._distances.least(pairs)
        if nearest < 0:
            return LeastDistance(distance, ("", ""))
        one, other = self._pairs[nearest]
        return LeastDistance(distance, (self._names[one], self._names[other]))


TELEGRAM_STEP = 1e-6 * np.pi / 180
"""Rounding of a setpoint to six decimals of a degree [rad]; of a millimetre it is less [m]."""


def record_cycle_s(record: Path) -> float:
    """The cycle of an emulated controller by its own record, whatever the cell says [s].

    What its arm does in a second is judged with this one: a controller that ticks faster moves faster.
    """
    with record.open(encoding="utf-8") as rows:
        next(rows)
        cycle, time_s, *_ = next(rows).split(",")
    return float(time_s) / int(cycle)


def limit_violations(robot: RobotModel, setpoints: Array, cycle_s: float) -> LimitCounts:
    """Count where consecutive setpoints pass a limit by more than the telegram's decimals explain.

    Args:
        robot: whose limits count.
        setpoints: (cycles, n) the emulated controller's setpoints [rad or m].
        cycle_s: time between two of them, by the controller's own record; see `record_cycle_s`.
    """
    position = (setpoints < robot.lower - TELEGRAM_STEP) | (setpoints > robot.upper + TELEGRAM_STEP)
    steps = np.diff(setpoints, axis=0)
    velocity = np.abs(steps) > robot.max_velocity * cycle_s + 2 * TELEGRAM_STEP
    changes = np.diff(steps, axis=0)
    acceleration = np.abs(changes) > robot.max_acceleration * cycle_s**2 + 4 * TELEGRAM_STEP
    return LimitCounts(
        position_violations=int(position.sum()),
        velocity_violations=int(velocity.sum()),
        acceleration_violations=int(acceleration.sum()),
    )
