"""Criteria of loads: joint torques and accelerations, how two arms share them, and what a task asks of a hand.

A cell's description has no torque limits. The torque that gives a joint its described acceleration with the robot at
home, `M_jj a_j`, stands in: a drive has at least that. Forces and loads are in this measure.
"""

from __future__ import annotations

import numpy as np

from deltaq_controllers.criteria.formulas import of_worst, singular
from deltaq_controllers.criteria.postures import Postures
from deltaq_protocol.arrays import Array, Flags


def _values(postures: Postures, scale: Array) -> Array:
    """(N, h, 3) singular values of the linear Jacobians, columns scaled by (n,)."""
    values: Array = np.asarray(
        np.linalg.svd(postures.jacobians[:, :, :3] * scale, compute_uv=False), np.float64
    )
    return values


def _derivatives(postures: Postures, scale: Array) -> tuple[Array, Array]:
    """The same, and their (N, h, 3, n) derivatives."""
    return singular(postures.jacobians[:, :, :3] * scale, postures.hessians[:, :, :3] * scale[:, None])


def acceleration(postures: Postures) -> Array:
    """Least singular value of J_v A [m/s^2]."""
    slowest: Array = _values(postures, postures.data.robot.max_acceleration)[:, :, -1].min(axis=1)
    return slowest


def acceleration_gradient(postures: Postures) -> Array:
    """Of `acceleration`."""
    values, derivatives = _derivatives(postures, postures.data.robot.max_acceleration)
    return of_worst(values[:, :, -1], "more", derivatives[:, :, -1])


def _shares(postures: Postures) -> Array:
    """(N, n) gravity's torque at each joint, as a fraction of what the drive has at least."""
    shares: Array = postures.gravity / postures.data.torques
    return shares


def _share_derivatives(postures: Postures) -> Array:
    """(N, n, n) derivatives of the squares of `_shares` by joint i at `[..., i]`."""
    change = postures.gravity_derivatives / postures.data.torques[:, None]
    derivatives: Array = 2.0 * _shares(postures)[:, :, None] * change
    return derivatives


def torque(postures: Postures) -> Array:
    """Mean square of gravity's torques."""
    value: Array = np.square(_shares(postures)).mean(axis=1)
    return value


def torque_gradient(postures: Postures) -> Array:
    """Of `torque`."""
    gradient: Array = _share_derivatives(postures).mean(axis=1)
    return gradient


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


def _greatest_share_gradient(loads: Array, derivatives: Array) -> Array:
    """Its derivative, of loads with derivatives (N, h, n)."""
    total = loads.sum(axis=1)[:, None]
    change = of_worst(loads, "less", derivatives) - _greatest_share(loads)[:, None] * derivatives.sum(axis=1)
    gradient: Array = np.divide(change, total, out=np.zeros_like(change), where=total > 0.0)
    return gradient


def relative_load(postures: Postures) -> Array:
    """Greatest fraction that one arm has of the arms' squared gravity torques."""
    return _greatest_share(np.square(_shares(postures)) @ _own(postures).T)


def relative_load_gradient(postures: Postures) -> Array:
    """Of `relative_load`."""
    own = _own(postures)
    derivatives = np.einsum("hj,nji->nhi", own, _share_derivatives(postures))
    return _greatest_share_gradient(np.square(_shares(postures)) @ own.T, derivatives)


def _energies(postures: Postures) -> tuple[Array, Array]:
    """(N, n) kinetic energy of each joint alone at full speed [J], and (N, n, n) its derivatives."""
    half = 0.5 * np.square(postures.data.robot.max_velocity)
    diagonal = np.einsum("njj->nj", postures.masses)
    return half * diagonal, half[:, None] * np.einsum("njji->nji", postures.mass_derivatives)


def relative_energy(postures: Postures) -> Array:
    """Greatest fraction that one arm has of the arms' kinetic energy."""
    half = 0.5 * np.square(postures.data.robot.max_velocity)
    return _greatest_share(half * np.einsum("njj->nj", postures.masses) @ _own(postures).T)


def relative_energy_gradient(postures: Postures) -> Array:
    """Of `relative_energy`."""
    own = _own(postures)
    energies, derivatives = _energies(postures)
    return _greatest_share_gradient(energies @ own.T, np.einsum("hj,nji->nhi", own, derivatives))


def _between(of_hands: Array) -> Array:
    """Of arrays of hands (N, h, ...) the first less the second, or the only one."""
    between: Array = of_hands[:, 0] - of_hands[:, 1] if of_hands.shape[1] > 1 else of_hands[:, 0]
    return between


def relative_compliance(postures: Postures) -> Array:
    """Mean deflection of two hands against one another per force [m/N]."""
    J = _between(postures.jacobians[:, :, :3])
    value: Array = (np.square(J) / postures.data.stiffness).sum(axis=(1, 2)) / 3.0
    return value


def relative_compliance_gradient(postures: Postures) -> Array:
    """Of `relative_compliance`."""
    J, H = _between(postures.jacobians[:, :, :3]), _between(postures.hessians[:, :, :3])
    gradient: Array = 2.0 / 3.0 * np.einsum("naj,naji->ni", J / postures.data.stiffness, H)
    return gradient


def force(postures: Postures) -> Array:
    """Force that the hand can exert in its weakest direction [N]."""
    value: Array = 1.0 / _values(postures, 1.0 / postures.data.torques)[:, :, 0].max(axis=1)
    return value


def force_gradient(postures: Postures) -> Array:
    """Of `force`."""
    values, derivatives = _derivatives(postures, 1.0 / postures.data.torques)
    greatest = values[:, :, 0].max(axis=1)[:, None]
    gradient: Array = -of_worst(values[:, :, 0], "less", derivatives[:, :, 0]) / np.square(greatest)
    return gradient


def deformation(postures: Postures) -> Array:
    """Deflection of the hand per force in its softest direction [m/N]."""
    value: Array = np.square(_values(postures, postures.data.stiffness**-0.5)[:, :, 0].max(axis=1))
    return value


def deformation_gradient(postures: Postures) -> Array:
    """Of `deformation`."""
    values, derivatives = _derivatives(postures, postures.data.stiffness**-0.5)
    greatest = values[:, :, 0].max(axis=1)[:, None]
    gradient: Array = 2.0 * greatest * of_worst(values[:, :, 0], "less", derivatives[:, :, 0])
    return gradient


def dexterity(postures: Postures) -> Array:
    """Least over greatest singular value of J_v."""
    values = _values(postures, np.ones(postures.q.shape[1]))
    ratio: Array = (values[:, :, -1] / values[:, :, 0]).min(axis=1)
    return ratio


def dexterity_gradient(postures: Postures) -> Array:
    """Of `dexterity`."""
    values, derivatives = _derivatives(postures, np.ones(postures.q.shape[1]))
    least, greatest = values[:, :, -1, None], values[:, :, 0, None]
    each = (derivatives[:, :, -1] - least / greatest * derivatives[:, :, 0]) / greatest
    return of_worst((least / greatest)[:, :, 0], "more", each)
