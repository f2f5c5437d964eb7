"""Configurations of a robot, and the formulas of the table: each a function of N configurations whose values are (N,).

A cell's description has no torque limits. The torque that gives a joint its described acceleration with the robot at
home, `M_jj a_j`, stands in: a drive has at least that. Forces and loads are in this measure.
"""

from collections.abc import Callable, Mapping
from functools import cached_property, partial

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.batch import BatchKinematics, FrameBatch
from deltaq_controllers.criteria.near_bodies import FAR_M, SOFT_M, MeasuredPairs, NearBodies, PairKind
from deltaq_controllers.task import NO_TASK, Task
from deltaq_protocol.arrays import Array, Flags

# Configurations with everything that criteria need of them, computed once and only on demand.

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
        task: names forces and directions of the hands, and which of them stay in place.
    """

    def __init__(
        self,
        cell: CellModel,
        robot: str,
        stiffness: Array | None = None,
        kinematics: BatchKinematics | None = None,
        others: Mapping[str, Array] | None = None,
        task: Task = NO_TASK,
    ) -> None:
        self.robot = cell.robots[robot]
        self.kinematics = kinematics or BatchKinematics(self.robot)
        self.bodies = NearBodies(cell, robot, others, {hand for hand, _, _ in task.tolerances()})
        self.forces = task.vectors("force_n", self.robot.hands)
        self.motions = task.vectors("motion", self.robot.hands)
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
        q: (N, n) configurations [rad or m]; columns of tolerances after these do not count.
    """

    def __init__(self, data: RobotData, q: Array) -> None:
        self.data = data
        self.q: Array = np.atleast_2d(np.asarray(q, dtype=np.float64))[:, : data.robot.n]

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
        return self.data.kinematics.hand_jacobians(self.frames)

    def in_world(self, vectors: Array) -> Array:
        """(N, h, 3) vectors (h, 3) in the hands' axes, in those of the world."""
        hands = zip(self.data.kinematics.hands, vectors, strict=True)
        return np.stack(
            [self.frames.rotation[joint] @ (turn @ vector) for (joint, turn, _), vector in hands], axis=1
        )

    @cached_property
    def masses(self) -> Array:
        """(N, n, n) mass matrix [kg m^2, kg m, kg]: `sum m J_v^T J_v + J_w^T I J_w` over the links, and the drives."""
        total = np.tile(np.diag(self.data.rotors), (len(self), 1, 1))
        for mass, J, I_world in self._links():
            linear, angular = J[:, :3], J[:, 3:]
            total += mass * linear.transpose(0, 2, 1) @ linear
            total += angular.transpose(0, 2, 1) @ I_world @ angular
        return total

    @cached_property
    def gravity(self) -> Array:
        """(N, n) torque or force of gravity against each joint [N m or N]."""
        total, kinematics = np.zeros_like(self.q), self.data.kinematics
        axes, origins = kinematics.columns(self.frames)
        for joint in np.flatnonzero(self.data.masses > 0.0):
            centre = self.frames.rotation[joint] @ self.data.centres[joint] + self.frames.position[joint]
            arm = centre[:, None] - origins
            lifted = axes[..., 0] * arm[..., 1] - axes[..., 1] * arm[..., 0]
            rows = np.where(kinematics.revolute, lifted, axes[..., 2]) * kinematics.moves[joint]
            total += GRAVITY_M_S2 * self.data.masses[joint] * rows
        return total

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


# The formulas.

STEP = 1e-5
"""Step of the central differences: also of those of a value that is itself a derivative [rad or m]."""

ROWS = 512
"""Configurations at which a value is taken at once: many are quick, but those of nested derivatives fill memory."""


def slopes(value: Callable[[Postures], Array], postures: Postures) -> Array:
    """(N, n) derivatives of a value (N,) by the joints, by central differences."""
    n = postures.q.shape[1]
    steps = STEP * np.concatenate([np.eye(n), -np.eye(n)])
    gradient, most = np.empty_like(postures.q), max(1, ROWS // len(steps))
    for first in range(0, len(postures), most):
        q = postures.q[first : first + most]
        near = Postures(postures.data, (q[:, None] + steps).reshape(-1, n))
        ahead, behind = np.moveaxis(value(near).reshape(len(q), 2, n), 1, 0)
        gradient[first : first + most] = (ahead - behind) / (2.0 * STEP)
    return gradient


# Criteria of hands: singular values of their Jacobians, and the hand that counts, which is the worst.


def _middle_half(postures: Postures) -> tuple[Array, Array]:
    robot = postures.data.robot
    return 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)


def travel(postures: Postures) -> Array:
    """Mean square of the joints' offsets from the middle, as fractions of half their range."""
    middle, half = _middle_half(postures)
    value: Array = np.square((postures.q - middle) / half).mean(axis=1)
    return value


def travel_gradient(postures: Postures) -> Array:
    """Of `travel`."""
    middle, half = _middle_half(postures)
    gradient: Array = 2.0 * (postures.q - middle) / half**2 / postures.q.shape[1]
    return gradient


def limits(postures: Postures) -> Array:
    """1 with all joints in their middle, growing without bound towards limits."""
    robot = postures.data.robot
    extent = robot.upper - robot.lower
    guard = 1e-6 * extent  # outside the limits the value at the limit stands for all
    below, above = np.maximum(robot.upper - postures.q, guard), np.maximum(postures.q - robot.lower, guard)
    value: Array = (extent**2 / (4.0 * below * above)).mean(axis=1)
    return value


def speed(postures: Postures) -> Array:
    """Least singular value of J_v D, or the ratio along a task's motion [m/s]."""
    slowest: Array = _slowest(postures, postures.data.robot.max_velocity).min(axis=1)
    return slowest


def _values(postures: Postures, scale: Array) -> Array:
    """(N, h, 3) singular values of the linear Jacobians, columns scaled by (n,)."""
    values: Array = np.asarray(
        np.linalg.svd(postures.jacobians[:, :, :3] * scale, compute_uv=False), np.float64
    )
    return values


def _slowest(postures: Postures, scale: Array) -> Array:
    """(N, h) of J = J_v diag(scale) the least singular value, or along a task's motion u `(u^T (J J^T)^-1 u)^-1/2`."""
    slowest: Array = _values(postures, scale)[:, :, -1]
    given = postures.data.motions.any(axis=1)
    if given.any():
        along, J = _units(postures, postures.data.motions)[:, given], postures.jacobians[:, given, :3] * scale
        square = J @ J.transpose(0, 1, 3, 2) + _DAMPING * np.eye(3)
        inverse = np.linalg.solve(square, along[..., None])[..., 0]
        slowest[:, given] = (along * inverse).sum(axis=2) ** -0.5
    return slowest


def _strained(postures: Postures, scale: Array) -> Array:
    """(N, h) of J = J_v diag(scale) the greatest singular value, or along a task's force u `|J^T u|`."""
    strained: Array = _values(postures, scale)[:, :, 0]
    given = postures.data.forces.any(axis=1)
    if given.any():
        along, J = _units(postures, postures.data.forces)[:, given], postures.jacobians[:, given, :3] * scale
        strained[:, given] = np.linalg.norm(np.einsum("nhi,nhij->nhj", along, J), axis=2)
    return strained


def _units(postures: Postures, vectors: Array) -> Array:
    """(N, h, 3) directions of vectors (h, 3) in the hands' axes, in those of the world; zero of zero ones."""
    sizes = np.linalg.norm(vectors, axis=1, keepdims=True)
    return postures.in_world(vectors / np.where(sizes > 0.0, sizes, 1.0))


_DAMPING = 1e-12
"""Added to the squares of a Jacobian: a singular one has no speed in the direction that is lost [m^2/s^2]."""


def manipulability(postures: Postures) -> Array:
    """Product of the singular values."""
    values = np.linalg.svd(postures.jacobians, compute_uv=False)
    product: Array = values.prod(axis=2).min(axis=1)
    return product


def condition(postures: Postures) -> Array:
    """Inverse condition number."""
    values = np.linalg.svd(postures.jacobians, compute_uv=False)
    ratio: Array = (values[..., -1] / values[..., 0]).min(axis=1)
    return ratio


def smallest(postures: Postures) -> Array:
    """Least singular value."""
    values = np.linalg.svd(postures.jacobians, compute_uv=False)
    least: Array = values[..., -1].min(axis=1)
    return least


def effective_mass(postures: Postures) -> Array:
    """Mass felt at the hand [kg]."""
    Jv = postures.jacobians[:, :, :3]
    X = np.asarray(np.linalg.solve(postures.masses[:, None], Jv.transpose(0, 1, 3, 2)), dtype=np.float64)
    mass: Array = (3.0 / np.einsum("nhaj,nhja->nh", Jv, X)).max(axis=1)
    return mass


def effective_mass_rate(postures: Postures) -> Array:
    """How fast the effective mass can change [kg/s]."""
    gradient = slopes(effective_mass, postures)
    rate: Array = np.linalg.norm(gradient * postures.data.robot.max_velocity, axis=1)
    return rate


def compliance(postures: Postures) -> Array:
    """Mean deflection of the hand per force [m/N]."""
    Jv = postures.jacobians[:, :, :3]
    value: Array = (np.square(Jv).sum(axis=2) / postures.data.stiffness).sum(axis=2).max(axis=1) / 3.0
    return value


def potential_partition(postures: Postures) -> Array:
    """How unevenly the joints share the deflection."""
    shares = np.square(postures.jacobians[:, :, :3]).sum(axis=2) / postures.data.stiffness
    value: Array = _unevenness(shares).max(axis=1)
    return value


def _energies(postures: Postures) -> Array:
    """(N, n) kinetic energy of each joint alone at full speed [J]."""
    diagonal = np.einsum("njj->nj", postures.masses)
    energies: Array = 0.5 * diagonal * np.square(postures.data.robot.max_velocity)
    return energies


def kinetic_energy(postures: Postures) -> Array:
    """Energy at full joint speed [J]."""
    energy: Array = _energies(postures).sum(axis=1)
    return energy


def kinetic_partition(postures: Postures) -> Array:
    """How unevenly the joints share the kinetic energy."""
    return _unevenness(_energies(postures))


def _unevenness(shares: Array) -> Array:
    total = shares.sum(axis=-1)
    value: Array = np.square(shares).sum(axis=-1) / np.square(total)
    return value


# Criteria of loads: joint torques and accelerations, their distribution over two arms, and a task's load on a hand.


def acceleration(postures: Postures) -> Array:
    """Least singular value of J_v A, or the ratio along a task's motion [m/s^2]."""
    slowest: Array = _slowest(postures, postures.data.robot.max_acceleration).min(axis=1)
    return slowest


def _shares(postures: Postures) -> Array:
    """(N, n) torque of gravity and of the task's forces at each joint, as a fraction of the drive's least torque."""
    forces = postures.in_world(postures.data.forces)
    load = postures.gravity + np.einsum("nhi,nhij->nj", forces, postures.jacobians[:, :, :3])
    shares: Array = load / postures.data.torques
    return shares


def torque(postures: Postures) -> Array:
    """Mean square of the torques of gravity and of the task's forces."""
    value: Array = np.square(_shares(postures)).mean(axis=1)
    return value


def _own(postures: Postures) -> Flags:
    """(h, n) the joints that move one hand only."""
    kinematics = postures.data.kinematics
    moved = np.array([kinematics.moves[joint] for joint, _, _ in kinematics.hands])
    own: Flags = moved & (moved.sum(axis=0) == 1)
    return own


def _greatest_share(loads: Array) -> Array:
    """(N,) the greatest of loads (N, h) as a fraction of them all; where nothing is loaded, all have the same."""
    total = loads.sum(axis=1)
    share = np.full(len(loads), 1.0 / loads.shape[1])
    np.divide(loads.max(axis=1), total, out=share, where=total > 0.0)
    return share


def relative_load(postures: Postures) -> Array:
    """Greatest fraction that one arm has of the arms' squared gravity torques."""
    return _greatest_share(np.square(_shares(postures)) @ _own(postures).T)


def relative_energy(postures: Postures) -> Array:
    """Greatest fraction that one arm has of the arms' kinetic energy."""
    half = 0.5 * np.square(postures.data.robot.max_velocity)
    return _greatest_share(half * np.einsum("njj->nj", postures.masses) @ _own(postures).T)


def _between(of_hands: Array) -> Array:
    """Of arrays of hands (N, h, ...) the first less the second, or the only one."""
    between: Array = of_hands[:, 0] - of_hands[:, 1] if of_hands.shape[1] > 1 else of_hands[:, 0]
    return between


def relative_compliance(postures: Postures) -> Array:
    """Mean deflection of two hands against one another per force [m/N]."""
    J = _between(postures.jacobians[:, :, :3])
    value: Array = (np.square(J) / postures.data.stiffness).sum(axis=(1, 2)) / 3.0
    return value


def force(postures: Postures) -> Array:
    """Force that the hand can exert in its weakest direction, or in that of the task's force [N]."""
    value: Array = 1.0 / _strained(postures, 1.0 / postures.data.torques).max(axis=1)
    return value


def deformation(postures: Postures) -> Array:
    """Deflection of the hand per force in its softest direction, or in that of the task's force [m/N]."""
    value: Array = np.square(_strained(postures, postures.data.stiffness**-0.5).max(axis=1))
    return value


def dexterity(postures: Postures) -> Array:
    """Least over greatest singular value of J_v."""
    values = _values(postures, np.ones(postures.q.shape[1]))
    ratio: Array = (values[:, :, -1] / values[:, :, 0]).min(axis=1)
    return ratio


# Clearance to obstacles, to other robots and of the robot from itself, each a criterion of its own.
#
# A clearance is a smooth minimum of the rooms r of the nearest pairs, `m - s log sum exp(-(r - m) / s)`, m the least
# of them. So two bodies that are equally near count more than one, and the gradient turns from one pair to another
# without a step.


def clearances(
    *kinds: PairKind,
) -> tuple[Callable[[Postures], Array], Callable[[Postures], Array]]:
    """The clearance of pairs of these kinds [m], and its gradient."""
    return partial(_room, kinds=kinds), partial(_gradient, kinds=kinds)


def _weights(postures: Postures, kinds: tuple[PairKind, ...]) -> tuple[Array, Array, Array]:
    """(N,) least room, FAR_M where nothing is near; (e,) weight of each pair; (N,) their sum and that of FAR_M."""
    near, least = postures.near, np.full(len(postures), FAR_M)
    counts = np.isin(near.kind, kinds)
    np.minimum.at(least, near.row[counts], near.room[counts])
    weight = np.where(counts, np.exp(-(near.room - least[near.row]) / SOFT_M), 0.0)
    total = np.exp(-(FAR_M - least) / SOFT_M)
    np.add.at(total, near.row, weight)
    return least, weight, total


def _room(postures: Postures, kinds: tuple[PairKind, ...]) -> Array:
    least, _, total = _weights(postures, kinds)
    room: Array = least - SOFT_M * np.log(total)
    return room


def _gradient(postures: Postures, kinds: tuple[PairKind, ...]) -> Array:
    near = postures.near
    _, weight, total = _weights(postures, kinds)
    gradient = np.zeros_like(postures.q)
    np.add.at(gradient, near.row, (weight / total[near.row])[:, None] * postures.near_rates)
    return gradient
