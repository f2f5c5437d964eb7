"""The formulas of the table, each a function of N configurations, and its gradient by the joints.

Values are (N,), gradients (N, n).
"""

from __future__ import annotations

import numpy as np

from deltaq_controllers.criteria.near_bodies import FAR_M, SOFT_M, PairKind
from deltaq_controllers.criteria.postures import Postures
from deltaq_protocol.arrays import Array, Flags

# Criteria of hands: singular values of their Jacobians, and the hand that counts, which is the worst.


def of_worst(values: Array, better: str, each: Array) -> Array:
    """(N, n) of `each` hand (N, h, n) that of the hand whose value (N, h) is the worst."""
    worst = values.argmin(axis=1) if better == "more" else values.argmax(axis=1)
    chosen: Array = each[np.arange(len(each)), worst]
    return chosen


def singular(J: Array, H: Array) -> tuple[Array, Array]:
    """(N, h, k) singular values of J (N, h, r, n), and their (N, h, k, n) derivatives from H (N, h, r, n, n)."""
    U, values, Vt = np.linalg.svd(J, full_matrices=False)
    return values, np.einsum("nhak,nhaji,nhkj->nhki", U, H, Vt, optimize=True)


RATE_STEP = 1e-5
"""Step of the central difference behind the gradient of the rate, which is a second derivative [rad or m]."""


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


def _room_to_limits(postures: Postures) -> tuple[Array, Array, Array]:
    robot = postures.data.robot
    extent = robot.upper - robot.lower
    guard = 1e-6 * extent  # outside the limits the value at the limit stands for all
    return np.maximum(robot.upper - postures.q, guard), np.maximum(postures.q - robot.lower, guard), extent


def limits(postures: Postures) -> Array:
    """1 with all joints in their middle, growing without bound towards limits."""
    below, above, extent = _room_to_limits(postures)
    value: Array = (extent**2 / (4.0 * below * above)).mean(axis=1)
    return value


def limits_gradient(postures: Postures) -> Array:
    """Of `limits`."""
    below, above, extent = _room_to_limits(postures)
    gradient: Array = extent**2 * (above - below) / (4.0 * np.square(below * above)) / postures.q.shape[1]
    return gradient


def speed(postures: Postures) -> Array:
    """Least singular value of J_v D [m/s]."""
    values = np.linalg.svd(_fast(postures), compute_uv=False)
    slowest: Array = values[..., -1].min(axis=1)
    return slowest


def speed_gradient(postures: Postures) -> Array:
    """Of `speed`."""
    D = postures.data.robot.max_velocity
    values, derivatives = singular(_fast(postures), postures.hessians[:, :, :3] * D[:, None])
    return of_worst(values[..., -1], "more", derivatives[:, :, -1])


def _fast(postures: Postures) -> Array:
    fast: Array = postures.jacobians[:, :, :3] * postures.data.robot.max_velocity
    return fast


def manipulability(postures: Postures) -> Array:
    """Product of the singular values."""
    values = np.linalg.svd(postures.jacobians, compute_uv=False)
    product: Array = values.prod(axis=2).min(axis=1)
    return product


def manipulability_gradient(postures: Postures) -> Array:
    """Of `manipulability`."""
    values, derivatives = singular(postures.jacobians, postures.hessians)
    count = values.shape[2]
    # the product of all others, without dividing: a singular value may be zero
    others = np.stack([np.delete(values, k, axis=2).prod(axis=2) for k in range(count)], axis=2)
    each = np.einsum("nhk,nhki->nhi", others, derivatives)
    return of_worst(values.prod(axis=2), "more", each)


def condition(postures: Postures) -> Array:
    """Inverse condition number."""
    values = np.linalg.svd(postures.jacobians, compute_uv=False)
    ratio: Array = (values[..., -1] / values[..., 0]).min(axis=1)
    return ratio


def condition_gradient(postures: Postures) -> Array:
    """Of `condition`."""
    values, derivatives = singular(postures.jacobians, postures.hessians)
    least, greatest = values[..., -1, None], values[..., 0, None]
    each = (derivatives[:, :, -1] - least / greatest * derivatives[:, :, 0]) / greatest
    return of_worst(values[..., -1] / values[..., 0], "more", each)


def smallest(postures: Postures) -> Array:
    """Least singular value."""
    values = np.linalg.svd(postures.jacobians, compute_uv=False)
    least: Array = values[..., -1].min(axis=1)
    return least


def smallest_gradient(postures: Postures) -> Array:
    """Of `smallest`."""
    values, derivatives = singular(postures.jacobians, postures.hessians)
    return of_worst(values[..., -1], "more", derivatives[:, :, -1])


def _mobility(postures: Postures) -> tuple[Array, Array]:
    """Per hand M^-1 J_v^T (N, h, n, 3), and the trace of J_v M^-1 J_v^T (N, h)."""
    Jv = postures.jacobians[:, :, :3]
    X = np.asarray(np.linalg.solve(postures.masses[:, None], Jv.transpose(0, 1, 3, 2)), dtype=np.float64)
    return X, np.einsum("nhaj,nhja->nh", Jv, X)


def effective_mass(postures: Postures) -> Array:
    """Mass felt at the hand [kg]."""
    _, trace = _mobility(postures)
    mass: Array = (3.0 / trace).max(axis=1)
    return mass


def effective_mass_gradient(postures: Postures) -> Array:
    """Of `effective_mass`."""
    X, trace = _mobility(postures)
    change = 2.0 * np.einsum("nhaji,nhja->nhi", postures.hessians[:, :, :3], X, optimize=True)
    change -= np.einsum("nhja,njki,nhka->nhi", X, postures.mass_derivatives, X, optimize=True)
    return of_worst(3.0 / trace, "less", -3.0 / np.square(trace)[..., None] * change)


def effective_mass_rate(postures: Postures) -> Array:
    """How fast the effective mass can change [kg/s]."""
    rate: Array = np.linalg.norm(effective_mass_gradient(postures) * postures.data.robot.max_velocity, axis=1)
    return rate


def effective_mass_rate_gradient(postures: Postures) -> Array:
    """Of `effective_mass_rate`, by central differences of the analytic gradient."""
    count, n = postures.q.shape
    steps = RATE_STEP * np.eye(n)
    around = np.concatenate([postures.q[:, None] + steps, postures.q[:, None] - steps], axis=1)
    rates = effective_mass_rate(Postures(postures.data, around.reshape(-1, n))).reshape(count, 2, n)
    gradient: Array = (rates[:, 0] - rates[:, 1]) / (2.0 * RATE_STEP)
    return gradient


def _shares(postures: Postures) -> tuple[Array, Array]:
    """Per hand the joints' shares of its deflection (N, h, n), and their derivatives (N, h, n, n) [m/N]."""
    Jv, Hv = postures.jacobians[:, :, :3], postures.hessians[:, :, :3]
    k = postures.data.stiffness
    return np.square(Jv).sum(axis=2) / k, 2.0 * np.einsum("nhaj,nhaji->nhji", Jv, Hv) / k[:, None]


def compliance(postures: Postures) -> Array:
    """Mean deflection of the hand per force [m/N]."""
    Jv = postures.jacobians[:, :, :3]
    value: Array = (np.square(Jv).sum(axis=2) / postures.data.stiffness).sum(axis=2).max(axis=1) / 3.0
    return value


def compliance_gradient(postures: Postures) -> Array:
    """Of `compliance`."""
    shares, derivatives = _shares(postures)
    return of_worst(shares.sum(axis=2), "less", derivatives.sum(axis=2)) / 3.0


def potential_partition(postures: Postures) -> Array:
    """How unevenly the joints share the deflection."""
    shares = np.square(postures.jacobians[:, :, :3]).sum(axis=2) / postures.data.stiffness
    value: Array = _unevenness(shares).max(axis=1)
    return value


def potential_partition_gradient(postures: Postures) -> Array:
    """Of `potential_partition`."""
    shares, derivatives = _shares(postures)
    return of_worst(_unevenness(shares), "less", _unevenness_gradient(shares, derivatives))


def _energies(postures: Postures) -> Array:
    """(N, n) kinetic energy of each joint alone at full speed [J]."""
    diagonal = np.einsum("njj->nj", postures.masses)
    energies: Array = 0.5 * diagonal * np.square(postures.data.robot.max_velocity)
    return energies


def _energy_derivatives(postures: Postures) -> Array:
    """(N, n, n) their derivatives."""
    diagonal = np.einsum("njji->nji", postures.mass_derivatives)
    derivatives: Array = 0.5 * diagonal * np.square(postures.data.robot.max_velocity)[:, None]
    return derivatives


def kinetic_energy(postures: Postures) -> Array:
    """Energy at full joint speed [J]."""
    energy: Array = _energies(postures).sum(axis=1)
    return energy


def kinetic_energy_gradient(postures: Postures) -> Array:
    """Of `kinetic_energy`."""
    gradient: Array = _energy_derivatives(postures).sum(axis=1)
    return gradient


def kinetic_partition(postures: Postures) -> Array:
    """How unevenly the joints share the kinetic energy."""
    return _unevenness(_energies(postures))


def kinetic_partition_gradient(postures: Postures) -> Array:
    """Of `kinetic_partition`."""
    return _unevenness_gradient(_energies(postures), _energy_derivatives(postures))


def _unevenness(shares: Array) -> Array:
    total = shares.sum(axis=-1)
    value: Array = np.square(shares).sum(axis=-1) / np.square(total)
    return value


def _unevenness_gradient(shares: Array, derivatives: Array) -> Array:
    """Of `sum s^2 / (sum s)^2`, for shares (..., n) with derivatives (..., n, n)."""
    total = shares.sum(axis=-1)[..., None]
    squares = np.square(shares).sum(axis=-1)[..., None]
    change = 2.0 * np.einsum("...j,...ji->...i", shares, derivatives)
    gradient: Array = change / total**2 - 2.0 * squares / total**3 * derivatives.sum(axis=-2)
    return gradient


# Clearance to obstacles, to other robots and of the robot from itself, each a criterion of its own.
#
# A clearance is a smooth minimum of the rooms r of the nearest pairs, `m - s log sum exp(-(r - m) / s)`, m the least
# of them. So two bodies that are equally near count more than one, and the gradient turns from one pair to another
# without a step.


def clearance(postures: Postures) -> Array:
    """Of all pairs [m]."""
    return _room(postures, np.ones(len(postures.near.row), dtype=np.bool_))


def clearance_gradient(postures: Postures) -> Array:
    """Of `clearance`."""
    return _gradient(postures, np.ones(len(postures.near.row), dtype=np.bool_))


def self_clearance(postures: Postures) -> Array:
    """Of the robot from itself [m]."""
    return _room(postures, postures.near.kind == PairKind.SELF)


def self_clearance_gradient(postures: Postures) -> Array:
    """Of `self_clearance`."""
    return _gradient(postures, postures.near.kind == PairKind.SELF)


def obstacle_clearance(postures: Postures) -> Array:
    """Of the robot from the structure [m]."""
    return _room(postures, postures.near.kind == PairKind.ENVIRONMENT)


def obstacle_clearance_gradient(postures: Postures) -> Array:
    """Of `obstacle_clearance`."""
    return _gradient(postures, postures.near.kind == PairKind.ENVIRONMENT)


def robot_clearance(postures: Postures) -> Array:
    """Of the robot from other robots [m]."""
    return _room(postures, postures.near.kind == PairKind.ROBOTS)


def robot_clearance_gradient(postures: Postures) -> Array:
    """Of `robot_clearance`."""
    return _gradient(postures, postures.near.kind == PairKind.ROBOTS)


def _weights(postures: Postures, counts: Flags) -> tuple[Array, Array, Array]:
    """(N,) least room, FAR_M where nothing is near; (e,) weight of each pair; (N,) their sum and that of FAR_M."""
    near, least = postures.near, np.full(len(postures), FAR_M)
    np.minimum.at(least, near.row[counts], near.room[counts])
    weight = np.where(counts, np.exp(-(near.room - least[near.row]) / SOFT_M), 0.0)
    total = np.exp(-(FAR_M - least) / SOFT_M)
    np.add.at(total, near.row, weight)
    return least, weight, total


def _room(postures: Postures, counts: Flags) -> Array:
    least, _, total = _weights(postures, counts)
    room: Array = least - SOFT_M * np.log(total)
    return room


def _gradient(postures: Postures, counts: Flags) -> Array:
    near = postures.near
    _, weight, total = _weights(postures, counts)
    gradient = np.zeros_like(postures.q)
    np.add.at(gradient, near.row, (weight / total[near.row])[:, None] * postures.near_rates)
    return gradient
