"""The formulas of the table, each a function of N configurations whose values are (N,).

A cell's description has no torque limits. The torque that gives a joint its described acceleration with the robot at
home, `M_jj a_j`, stands in: a drive has at least that. Forces and loads are in this measure.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from deltaq_controllers.criteria.near_bodies import FAR_M, SOFT_M, PairKind
from deltaq_controllers.criteria.postures import Postures
from deltaq_protocol.arrays import Array, Flags

STEP = 1e-5
"""Step of the central differences: also of those of a value that is itself a derivative [rad or m]."""


def slopes(value: Callable[[Postures], Array], postures: Postures) -> Array:
    """(N, n) derivatives of a value (N,) by the joints, by central differences."""
    n = postures.q.shape[1]
    steps = STEP * np.concatenate([np.eye(n), -np.eye(n)])
    # configuration by configuration: a value may be made of derivatives, and all at once fill the memory
    rows = [value(Postures(postures.data, q + steps)).reshape(2, n) for q in postures.q]
    gradient: Array = np.array([(ahead - behind) / (2.0 * STEP) for ahead, behind in rows]).reshape(-1, n)
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
    """Least singular value of J_v D [m/s]."""
    slowest: Array = _values(postures, postures.data.robot.max_velocity)[:, :, -1].min(axis=1)
    return slowest


def _values(postures: Postures, scale: Array) -> Array:
    """(N, h, 3) singular values of the linear Jacobians, columns scaled by (n,)."""
    values: Array = np.asarray(
        np.linalg.svd(postures.jacobians[:, :, :3] * scale, compute_uv=False), np.float64
    )
    return values


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
    """Least singular value of J_v A [m/s^2]."""
    slowest: Array = _values(postures, postures.data.robot.max_acceleration)[:, :, -1].min(axis=1)
    return slowest


def _shares(postures: Postures) -> Array:
    """(N, n) gravity's torque at each joint, as a fraction of the drive's least torque."""
    shares: Array = postures.gravity / postures.data.torques
    return shares


def torque(postures: Postures) -> Array:
    """Mean square of gravity's torques."""
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
    """Force that the hand can exert in its weakest direction [N]."""
    value: Array = 1.0 / _values(postures, 1.0 / postures.data.torques)[:, :, 0].max(axis=1)
    return value


def deformation(postures: Postures) -> Array:
    """Deflection of the hand per force in its softest direction [m/N]."""
    value: Array = np.square(_values(postures, postures.data.stiffness**-0.5)[:, :, 0].max(axis=1))
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
