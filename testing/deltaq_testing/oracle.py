"""The independent checker: measures the distances of bodies, and checks limits.

It shares only bodies and kinematics with the gate: it places every recorded configuration and measures every pair
that can be nearest, without inflating bodies. Limits are checked on the emulated controller's record of its
setpoints, not on a service's intentions.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Self

import numpy as np
import pinocchio as pin
from pydantic import BaseModel

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array, Indices


class _Counts(BaseModel, frozen=True):
    @classmethod
    def sum(cls, counts: Iterable[Self]) -> Self:
        """Those of several robots or runs together."""
        dumped = [count.model_dump() for count in counts]
        return cls(**{name: sum(one[name] for one in dumped) for name in cls.model_fields})


class LimitCounts(_Counts):
    """How many joints of how many cycles were beyond a limit."""

    position_violations: int = 0
    velocity_violations: int = 0
    acceleration_violations: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return self.position_violations + self.velocity_violations + self.acceleration_violations


class GateCounts(_Counts):
    """Verdicts by outcome."""

    admitted: int = 0
    scaled: int = 0
    held: int = 0
    refused: int = 0

    @classmethod
    def of(cls, counts: dict[str, int]) -> Self:
        """From a counter that may hold other counts as well."""
        return cls(**{name: counts.get(name, 0) for name in cls.model_fields})


# Distances of many pairs of bodies along a motion; only pairs that can be below the bound are measured.
#
# No point of a body moves further than the centre of a ball around it, plus the ball's radius times the
# norm of what its rotation changes by. So a pair's last distance, minus the motion of both bodies since, is a lower
# bound of its distance, and a pair whose bound is above the requested one need not be measured again. The bound is
# made of two placements and knows nothing of joints.

_INEXACT_M = 1e-5
"""Subtracted from every bound: ten times the tolerance of coal's iterations."""


@dataclass
class _Placed:
    """One robot's bodies: which joint carries each, a ball around each, and where they were placed last."""

    robot: RobotModel
    data: pin.Data
    geometry_data: pin.GeometryData
    places: slice
    joints: Indices
    centres: Array
    radii: Array
    q: Array
    joint_poses: Array


class PairDistances:
    """Measures pairs of bodies where robots are placed.

    Args:
        robots: by name.
        structure: bodies that stand still.
        pairs: (k, 2) places of the bodies of each pair among all: each robot's in turn, then the structure's.
    """

    def __init__(
        self,
        robots: Mapping[str, RobotModel],
        structure: Sequence[pin.GeometryObject],
        pairs: Sequence[tuple[int, int]],
    ) -> None:
        self._geometry = pin.GeometryModel()
        self._placed: dict[str, _Placed] = {}
        for name, robot in robots.items():
            first = self._geometry.ngeoms
            for body in robot.geometry.geometryObjects:
                self._add(body)
            self._placed[name] = _placed(robot, first)
        for body in structure:
            self._add(body)
        for one, other in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(one, other))
        self._data = self._geometry.createData()
        for place, body in enumerate(self._geometry.geometryObjects):
            self._data.oMg[place] = body.placement
        self._first, self._second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T.copy()
        self._moved_m = np.zeros(self._geometry.ngeoms)
        # each pair's last distance, plus its bodies' travel until then
        self._measured_m = np.full(len(pairs), -np.inf)

    def place(self, configurations: Mapping[str, Array]) -> None:
        """Place robots at (n,) [rad or m] each."""
        for name, q in configurations.items():
            placed = self._placed[name]
            if (q == placed.q).all():
                continue
            placed.q = np.array(q)
            robot, data = placed.robot, placed.data
            pin.updateGeometryPlacements(robot.model, data, robot.geometry, placed.geometry_data, q)
            for place, pose in enumerate(placed.geometry_data.oMg, start=placed.places.start):
                self._data.oMg[place] = pose
            poses = np.array([pose.homogeneous for pose in data.oMi])[:, :3]
            change = poses - placed.joint_poses
            placed.joint_poses = poses
            # the Frobenius norm is sqrt(2) times the spectral one where two rotations differ
            turned = np.sqrt(np.square(change[:, :, :3]).sum(axis=(1, 2)) / 2)[placed.joints]
            shifted = (change[placed.joints] @ placed.centres[:, :, None])[:, :, 0]
            self._moved_m[placed.places] += np.sqrt(np.square(shifted).sum(axis=1)) + turned * placed.radii

    def least(self, pairs: Indices, levels_m: Array | float = 0.0) -> tuple[float, int]:
        """Least of the distances of some pairs, each minus its level [m], and its pair; -1 without pairs."""
        if not pairs.size:
            return np.inf, -1
        levels = np.broadcast_to(levels_m, pairs.shape)
        bounds = self._bounds(pairs) - levels
        first = int(np.argmin(bounds))
        least, nearest = self._measure(int(pairs[first])) - float(levels[first]), int(pairs[first])
        bounds[first] = np.inf
        near = np.flatnonzero(bounds < least)
        for index in near[np.argsort(bounds[near])].tolist():
            if bounds[index] >= least:
                break
            room = self._measure(int(pairs[index])) - float(levels[index])
            if room < least:
                least, nearest = room, int(pairs[index])
        return least, nearest

    def below(self, limits_m: Array) -> Array:
        """(k,) distance of every pair that is below its limit; for others a lower bound [m]."""
        found = self._bounds(np.arange(len(self._first)))
        for pair in np.flatnonzero(found < limits_m).tolist():
            found[pair] = self._measure(pair)
        return found

    def _bounds(self, pairs: Indices) -> Array:
        moved = self._moved_m[self._first[pairs]] + self._moved_m[self._second[pairs]]
        bounds: Array = self._measured_m[pairs] - moved - _INEXACT_M
        return bounds

    def _measure(self, pair: int) -> float:
        pin.computeDistance(self._geometry, self._data, pair)
        distance = float(self._data.distanceResults[pair].min_distance)
        moved = self._moved_m[self._first[pair]] + self._moved_m[self._second[pair]]
        self._measured_m[pair] = distance + moved
        return distance

    def _add(self, body: pin.GeometryObject) -> None:
        self._geometry.addGeometryObject(pin.GeometryObject(body.name, 0, body.placement, body.geometry))


def _placed(robot: RobotModel, first: int) -> _Placed:
    bodies = list(robot.geometry.geometryObjects)
    for body in bodies:
        body.geometry.computeLocalAABB()
    centres = [body.placement.act(body.geometry.aabb_center) for body in bodies]
    return _Placed(
        robot,
        robot.model.createData(),
        robot.geometry.createData(),
        slice(first, first + len(bodies)),
        np.array([body.parentJoint for body in bodies], dtype=np.intp),
        np.hstack([np.reshape(centres, (-1, 3)), np.ones((len(bodies), 1))]),
        np.array([body.geometry.aabb_radius for body in bodies]),
        np.full(robot.n, np.nan),
        np.zeros((robot.model.njoints, 3, 4)),
    )


STRUCTURE = "structure"
"""Owner of the fixed bodies."""


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
        stop_distances_m: (pairs,) stop distances [m].
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

    def levels_m(self, may_touch: Iterable[tuple[str, str]]) -> Array:
        """(pairs,) stop distances for `least_room_m`; pairs that may touch, by the names of their bodies, have none."""
        levels = self.stop_distances_m.copy()
        levels[[self._numbers[frozenset(pair)] for pair in may_touch]] = -np.inf
        return levels

    def least_room_m(self, configurations: Mapping[str, Array], levels_m: Array) -> float:
        """Least distance beyond its level, over all pairs; infinite without pairs.

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
            limits_m: (pairs,) distances beyond which a bound is enough.
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
    """The cycle of an emulated controller by its own record, not by the cell [s].

    Rates of its arm are computed with it: a controller that ticks faster moves faster.
    """
    with record.open(encoding="utf-8") as rows:
        next(rows)
        cycle, time_s, *_ = next(rows).split(",")
    return float(time_s) / int(cycle)


def rows_of(record: Path, from_byte: int = 0) -> Array:
    """Whole rows of a record that is being written: cycle, q (n), setpoint (n), 1 while RSI runs.

    Args:
        record: the file.
        from_byte: start of reading; the line at it is skipped, like the heading.
    """
    with record.open(encoding="utf-8") as file:
        file.seek(from_byte)
        text = file.read()
    lines = text[: text.rfind("\n")].splitlines()[1:]
    rows = []
    for line in lines:
        cycle, _, *numbers, state = line.split(",")
        rows.append([float(cycle), *map(float, numbers), float(state == KrcState.RSI_RUNNING)])
    return np.array(rows)


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
