"""Clearance to obstacles, to other robots and of the robot from itself, each a criterion of its own.

A clearance is a smooth minimum of the rooms r of the nearest pairs, `m - s log sum exp(-(r - m) / s)`, m the least
of them. So two bodies that are equally near count more than one, and the gradient turns from one pair to another
without a step.
"""

from __future__ import annotations

import numpy as np

from deltaq_controllers.criteria.near_bodies import FAR_M, SOFT_M, PairKind
from deltaq_controllers.criteria.postures import Postures
from deltaq_protocol.arrays import Array, Flags


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
