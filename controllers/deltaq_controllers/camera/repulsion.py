"""Repulsive field of Bjerkeng et al., (12): from the leader's spheres and from the floor.

As printed, (12) is `|o - b| / d` times the gradient of Khatib's potential, with no gain; here it is the
gradient, `eta (1/d - 1/rho_0) / d^2 J_o^T n`, with d clamped from below: past contact the gradient would attract.
The floor is a plane, so b is the foot point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_controllers.kinematics import Kinematics, joints_that_move
from deltaq_controllers.spheres import Spheres

Array = NDArray[np.float64]

_TRAVEL_MARGIN = 1.5
"""Intermediate points of a Runge-Kutta step may lie a little outside the increment cap."""


@dataclass(frozen=True)
class Potential:
    """Size of a push by clearance.

    Attributes:
        gain: eta [m^3 rad/s].
        range_m: rho_0, the clearance from which on nothing is pushed [m].
        min_m: a smaller clearance counts as this one [m].
        as_printed: (12) to the letter.
    """

    gain: float
    range_m: float
    min_m: float
    as_printed: bool = False

    def push(self, clearance: Array, between_centres: Array) -> Array:
        """Size of each push.

        Args:
            clearance: d, negative inside one another [m].
            between_centres: |o - b|, which only the print makes use of [m].
        """
        d = np.maximum(clearance, self.min_m)
        size: Array = self.gain * np.maximum(1.0 / d - 1.0 / self.range_m, 0.0) / (d * d)
        return size * between_centres / d if self.as_printed else size


class Repulsion:
    """Repulsion of one robot's bounding spheres from given spheres and from the floor.

    `approach` once per increment finds the spheres that can come into range during it; `field` then looks at
    those only.

    Args:
        robot: the robot that is pushed.
        potential: size of the pushes.
        max_dq: (n,) farthest that the joints go from `approach` to `field` [rad or m].
        floor_m: height of the floor, None for none [m].
    """

    def __init__(self, robot: RobotModel, potential: Potential, max_dq: Array, floor_m: float | None) -> None:
        self._spheres = Spheres.of(robot)
        self._potential = potential
        self._floor_m = 0.0 if floor_m is None else floor_m
        moves = joints_that_move(robot, self._spheres.joints)
        self._moves = moves.astype(np.float64)
        travel = _TRAVEL_MARGIN * moves * _reach(robot, self._spheres) @ max_dq
        self._within = potential.range_m + travel
        sinks = (
            np.zeros(len(moves), dtype=np.bool_) if floor_m is None else _changes_height(robot, self._spheres)
        )
        self._floor_reach = np.where(sinks, self._spheres.radii, -np.inf)
        self._nearby: _Nearby | None = None

    def approach(self, kinematics: Kinematics, obstacles: Array, radii: Array) -> float:
        """Note what is near at the configuration of `kinematics`.

        Args:
            kinematics: placed at the start of the increment.
            obstacles: (k, 3) centres of the spheres to keep clear of, in the world [m].
            radii: (k,) their radii [m].

        Returns:
            Least clearance [m]; infinite if there is neither a floor nor an obstacle.
        """
        centres, own = self._spheres.placed(kinematics.placements()), self._spheres.radii
        clearance = _distances(centres, obstacles)
        clearance -= own[:, None]
        clearance -= radii
        above = centres[:, 2] - self._floor_m - self._floor_reach
        near = np.flatnonzero((clearance < self._within[:, None]).any(axis=0))
        self._nearby = None
        if near.size or (above < self._within).any():
            reach = np.column_stack([own[:, None] + radii[near], self._floor_reach])
            self._nearby = _Nearby(obstacles[near], reach)
        return min(float(clearance.min(initial=np.inf)), float(above.min()))

    def field(self, kinematics: Kinematics) -> Array:
        """F_rep (n,) at the configuration of `kinematics` [rad/s or m/s]."""
        near = self._nearby
        if near is None:
            return np.zeros(kinematics.columns.shape[1])
        centres = self._spheres.placed(kinematics.placements())
        apart = self._apart(centres, near.obstacles)
        between = np.sqrt((apart * apart).sum(axis=0))
        push = self._potential.push(between - near.reach, between)
        force = np.einsum("imk,mk->im", apart, push / np.maximum(between, 1e-9))
        # J_o^T f = linear^T f + angular^T (o x f), summed over the spheres that each joint moves
        wrench = np.empty((6, len(centres)))
        (x, y, z), (fx, fy, fz) = centres.T, force
        wrench[:3] = force
        wrench[3], wrench[4], wrench[5] = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
        field: Array = (kinematics.columns * (wrench @ self._moves)).sum(axis=0)
        return field

    def _apart(self, centres: Array, obstacles: Array) -> Array:
        """(3, m, k + 1) o - b of the spheres (m, 3) and obstacles (k, 3), and last of their foot points [m]."""
        apart = np.zeros((3, len(centres), len(obstacles) + 1))
        np.subtract(centres.T[:, :, None], obstacles.T[:, None], out=apart[:, :, :-1])
        apart[2, :, -1] = centres[:, 2] - self._floor_m
        return apart


@dataclass(frozen=True)
class _Nearby:
    """Obstacles in reach of one increment, (k, 3), and how far from them and the floor is contact, (m, k + 1) [m]."""

    obstacles: Array
    reach: Array


def _distances(points: Array, others: Array) -> Array:
    """(m, k) distances of points (m, 3) and (k, 3), by the law of cosines in place: they are many [m]."""
    distances = points @ (-2.0 * others.T)
    distances += np.einsum("ij,ij->i", points, points)[:, None]
    distances += np.einsum("ij,ij->i", others, others)
    np.maximum(distances, 0.0, out=distances)
    np.sqrt(distances, out=distances)
    return distances


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
