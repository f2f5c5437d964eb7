"""Repulsive field of Bjerkeng et al., (12): from the leader's spheres and from the floor.

As printed, (12) is `|o - b| / d` times the gradient of Khatib's potential, with no gain; here it is the
gradient, `eta (1/d - 1/rho_0) / d^2 J_o^T n`, with d clamped from below: past contact the gradient would attract.
The floor is a plane, so b is the foot point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.kinematics import Kinematics, joints_that_move
from deltaq_controllers.spheres import Spheres, placed
from deltaq_controllers.vectors import distance
from deltaq_protocol.arrays import Array

_TRAVEL_MARGIN = 1.5
"""Intermediate points of a Runge-Kutta step may lie a little outside the increment cap."""


class Potential(NamedTuple):
    """Size of a push by clearance.

    Attributes:
        gain: eta [m^3 rad/s].
        range_m: rho_0, the clearance beyond which there is no push [m].
        min_m: a smaller clearance counts as this one [m].
    """

    gain: float
    range_m: float
    min_m: float


@compiled
def push(potential: Potential, clearance: float) -> float:
    """Size of one push.

    Args:
        potential: its size by clearance.
        clearance: d, negative inside one another [m].
    """
    if clearance >= potential.range_m:
        return 0.0
    d = max(clearance, potential.min_m)
    return potential.gain * (1.0 / d - 1.0 / potential.range_m) / (d * d)


class Obstacles(NamedTuple):
    """Spheres to keep clear of: centres (k, 3) in the world and radii (k,) [m]."""

    centres: Array
    radii: Array


class Repulsion:
    """Repulsion of one robot's bounding spheres from given spheres and from the floor.

    `approach` once per increment finds the spheres that can come into range during it; `field` then uses only those.

    Args:
        robot: the robot that is pushed.
        potential: size of the pushes.
        max_dq: (n,) farthest that the joints go from `approach` to `field` [rad or m].
        floor_m: height of the floor, None for none [m].
    """

    def __init__(self, robot: RobotModel, potential: Potential, max_dq: Array, floor_m: float | None) -> None:
        self._spheres = Spheres.of(robot)
        self._potential = potential
        self._moves = joints_that_move(robot, self._spheres.joints)
        travel = _TRAVEL_MARGIN * self._moves * _reach(robot, self._spheres) @ max_dq
        self._within = potential.range_m + travel
        sinks = (
            np.zeros(len(travel), dtype=np.bool_)
            if floor_m is None
            else _changes_height(robot, self._spheres)
        )
        reach = np.where(sinks, self._spheres.radii, -np.inf)
        self._floor = Floor(0.0 if floor_m is None else floor_m, reach)
        self._near: Obstacles | None = None

    def approach(self, kinematics: Kinematics, obstacles: Array, radii: Array) -> float:
        """Find the near obstacles at the configuration of `kinematics`.

        Args:
            kinematics: placed at the start of the increment.
            obstacles: (k, 3) centres of the spheres to keep clear of, in the world [m].
            radii: (k,) their radii [m].

        Returns:
            Least clearance from an obstacle [m]; infinite if there is none. The floor does not count: it pushes, and is
            no reason to give up the view.
        """
        least, near, any_near = _approach(
            self._spheres, kinematics.placements(), self._within, Obstacles(obstacles, radii), self._floor
        )
        self._near = Obstacles(obstacles[near], radii[near]) if any_near else None
        return least

    def field(self, kinematics: Kinematics) -> Array:
        """F_rep (n,) at the configuration of `kinematics`, of the obstacles found last [rad/s or m/s]."""
        if self._near is None:
            return np.zeros(kinematics.columns.shape[1])
        return self.field_of(kinematics, self._near)

    def field_of(self, kinematics: Kinematics, obstacles: Obstacles) -> Array:
        """F_rep (n,) of given obstacles and of the floor [rad/s or m/s]."""
        return _field(
            kinematics.columns,
            self._moves,
            self._spheres,
            kinematics.placements(),
            self._potential,
            obstacles,
            self._floor,
        )


class Floor(NamedTuple):
    """The floor, and the spheres that can touch it.

    Attributes:
        height: of the floor [m].
        reach: (m,) height above it at which each sphere's centre touches it; -inf for spheres that never do [m].
    """

    height: float
    reach: Array


@compiled
def _approach(
    spheres: Spheres, placements: Array, within: Array, obstacles: Obstacles, floor: Floor
) -> tuple[float, NDArray[np.bool_], bool]:
    """Least clearance [m], (k,) which obstacles come `within` (m,) of a sphere, and whether any, or the floor, does."""
    centres = placed(spheres, placements)
    near: NDArray[np.bool_] = np.zeros(len(obstacles.radii), dtype=np.bool_)
    least = np.inf
    for k in range(len(near)):
        for i in range(len(centres)):
            clearance = distance(centres[i], obstacles.centres[k]) - spheres.radii[i] - obstacles.radii[k]
            least = min(least, clearance)
            near[k] |= clearance < within[i]
    above = centres[:, 2] - floor.height - floor.reach
    return least, near, bool(near.any() or (above < within).any())


@compiled
def _field(
    columns: Array,
    moves: NDArray[np.bool_],
    spheres: Spheres,
    placements: Array,
    potential: Potential,
    obstacles: Obstacles,
    floor: Floor,
) -> Array:
    """(n,) sum of J_o^T f over spheres, where `moves` (m, n) tells which joints, with `columns` (6, n), move which."""
    centres, radii = placed(spheres, placements), spheres.radii
    field, wrench = np.zeros(columns.shape[1]), np.zeros(6)
    for i in range(len(centres)):
        x, y, z = centres[i, 0], centres[i, 1], centres[i, 2]
        fx = fy = 0.0
        fz = push(potential, z - floor.height - floor.reach[i])
        for k in range(len(obstacles.radii)):
            dx, dy, dz = x - obstacles.centres[k, 0], y - obstacles.centres[k, 1], z - obstacles.centres[k, 2]
            between = math.sqrt(dx * dx + dy * dy + dz * dz)
            size = push(potential, between - radii[i] - obstacles.radii[k]) / max(between, 1e-9)
            fx, fy, fz = fx + size * dx, fy + size * dy, fz + size * dz
        wrench[0], wrench[1], wrench[2] = fx, fy, fz
        wrench[3], wrench[4], wrench[5] = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
        for joint in range(len(field)):
            if moves[i, joint]:
                for axis in range(6):
                    field[joint] += columns[axis, joint] * wrench[axis]
    return field


def _reach(robot: RobotModel, spheres: Spheres) -> Array:
    """(m, n) bound of how far a sphere's centre moves per unit of each joint: links laid end to end [m]."""
    model = robot.model
    lengths = np.array([np.linalg.norm(placement.translation) for placement in model.jointPlacements])
    reach = np.zeros((len(spheres.joints), robot.n))
    for row, carrier in enumerate(spheres.joints.tolist()):
        beyond = float(np.linalg.norm(spheres.centres[row]))
        joint = carrier
        while joint > 0:
            reach[row, joint - 1] = beyond if robot.revolute[joint - 1] else 1.0
            slide = 0.0 if robot.revolute[joint - 1] else robot.upper[joint - 1] - robot.lower[joint - 1]
            beyond += float(lengths[joint]) + slide
            joint = int(model.parents[joint])
    return reach


def _changes_height(robot: RobotModel, spheres: Spheres) -> NDArray[np.bool_]:
    """(m,) spheres whose height above the floor some joint can change."""
    kinematics = Kinematics(robot, "tool")
    generator = np.random.default_rng(0)
    heights = []
    for _ in range(5):
        kinematics.update(generator.uniform(robot.lower, robot.upper))
        heights.append(spheres.placed(kinematics.placements())[:, 2])
    changes: NDArray[np.bool_] = np.ptp(np.array(heights), axis=0) > 1e-9
    return changes
