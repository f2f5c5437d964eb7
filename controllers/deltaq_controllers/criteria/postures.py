"""Configurations of a robot with everything that criteria need of them, computed once and only on demand."""

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.batch import BatchKinematics, FrameBatch
from deltaq_controllers.criteria.near_bodies import MeasuredPairs, NearBodies
from deltaq_protocol.arrays import Array

STIFFNESS_RAD, STIFFNESS_M = 1e5, 1e7
"""Joint stiffness where none is given: stand-ins [N m/rad and N/m]."""

GRAVITY_M_S2 = 9.80665

ROTOR_RAD, ROTOR_M = 0.05, 1.0
"""What a joint's drive adds to the mass matrix, seen through its gear: stand-ins [kg m^2 and kg]."""


class RobotData:
    """Data that criteria use of a robot beyond its configuration.

    Args:
        cell: model of the cell, for the bodies around the robot.
        robot: name of the robot.
        stiffness: (n,) of the joints [N m/rad or N/m]; stand-ins if not given.
        kinematics: of the robot; made if not given.
        others: (n,) configuration of each other robot whose bodies count; none if not given.
    """

    def __init__(
        self,
        cell: CellModel,
        robot: str,
        stiffness: Array | None = None,
        kinematics: BatchKinematics | None = None,
        others: Mapping[str, Array] | None = None,
    ) -> None:
        self.robot = cell.robots[robot]
        self.kinematics = kinematics or BatchKinematics(self.robot)
        self.bodies = NearBodies(cell, robot, others)
        given = np.where(self.robot.revolute, STIFFNESS_RAD, STIFFNESS_M)
        self.stiffness: Array = given if stiffness is None else np.asarray(stiffness, dtype=np.float64)
        self.rotors = np.where(self.robot.revolute, ROTOR_RAD, ROTOR_M)
        inertias = [self.robot.model.inertias[joint + 1] for joint in range(self.robot.n)]
        self.masses = np.array([float(inertia.mass) for inertia in inertias])
        self.centres = np.array([inertia.lever for inertia in inertias])
        self.inertias = np.array([inertia.inertia for inertia in inertias])

    @cached_property
    def torques(self) -> Array:
        """(n,) torque that gives each joint its acceleration with the robot at home [N m or N]: a stand-in."""
        (masses,) = Postures(self, self.robot.home).masses
        torques: Array = np.diagonal(masses) * self.robot.max_acceleration
        return torques


class Postures:
    """N configurations.

    Args:
        data: of the robot.
        q: (N, n) configurations [rad or m].
    """

    def __init__(self, data: RobotData, q: Array) -> None:
        self.data = data
        self.q = np.atleast_2d(np.asarray(q, dtype=np.float64))

    def __len__(self) -> int:
        return len(self.q)

    @cached_property
    def frames(self) -> FrameBatch:
        """All joints, placed."""
        return self.data.kinematics.frames(self.q)

    @cached_property
    def near(self) -> MeasuredPairs:
        """The nearest pairs of bodies of each configuration, e pairs in total."""
        return self.data.bodies.near(self.q)

    @cached_property
    def near_rates(self) -> Array:
        """(e, n) derivative of the distance of each pair of `near` with respect to the joints [m/rad or 1]."""
        near, kinematics = self.near, self.data.kinematics
        rates = np.zeros((len(near.row), self.q.shape[1]))
        if not len(near.row):
            return rates
        axes, origins = kinematics.columns(self.frames)
        axes, origins, away = axes[near.row], origins[near.row], near.away[:, None]
        # away . (axis x r) = (away x axis) . r
        turned = np.cross(away, axes)
        slid = (away * axes).sum(axis=2)
        for carriers, points, sign in ((near.first, near.on_first, 1.0), (near.second, near.on_second, -1.0)):
            along = np.einsum("eni,eni->en", turned, points[:, None] - origins)
            columns = np.where(kinematics.revolute, along, slid)
            rates += sign * columns * (kinematics.moves[carriers] & (carriers >= 0)[:, None])
        return rates

    @cached_property
    def jacobians(self) -> Array:
        """(N, h, 6, n) Jacobian of each hand, linear over angular, world axes."""
        kinematics, frames = self.data.kinematics, self.frames
        points = [
            (joint, frames.position[joint] + frames.rotation[joint] @ place)
            for joint, _, place in kinematics.hands
        ]
        return np.stack([kinematics.jacobian(frames, *point) for point in points], axis=1)

    @cached_property
    def masses(self) -> Array:
        """(N, n, n) mass matrix [kg m^2, kg m, kg]: `sum m J_v^T J_v + J_w^T I J_w` over the links, and the drives."""
        total = np.tile(np.diag(self.data.rotors), (len(self), 1, 1))
        for mass, J, I_world in self._links:
            linear, angular = J[:, :3], J[:, 3:]
            total += mass * linear.transpose(0, 2, 1) @ linear
            total += angular.transpose(0, 2, 1) @ I_world @ angular
        return total

    @cached_property
    def gravity(self) -> Array:
        """(N, n) torque or force of gravity against each joint [N m or N]."""
        total = np.zeros_like(self.q)
        for mass, J, _ in self._links:
            total += GRAVITY_M_S2 * mass * J[:, 2]
        return total

    @cached_property
    def _links(self) -> list[tuple[float, Array, Array]]:
        """Of each link with a mass: its mass, Jacobian of its centre, and inertia in the world."""
        kinematics, frames, links = self.data.kinematics, self.frames, []
        for joint in range(self.data.robot.n):
            mass = float(self.data.masses[joint])
            if mass <= 0.0:
                continue
            R = frames.rotation[joint]
            J = kinematics.jacobian(frames, joint, frames.position[joint] + R @ self.data.centres[joint])
            links.append((mass, J, R @ self.data.inertias[joint] @ R.transpose(0, 2, 1)))
        return links
