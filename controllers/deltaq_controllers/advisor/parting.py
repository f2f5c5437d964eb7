"""The beginning of a path where a robot stands close to a body: first away from it.

A robot that was driven by hand until the gate stopped it stands at its stop distance. On a path that begins along the
body the gate, which has to be able to brake, holds it; so paths begin where there is room.
"""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.motion_validator import FINE, LEAP
from deltaq_controllers.advisor.space import Space
from deltaq_protocol.arrays import Array

_PROBED = 1e-4
"""Change of a joint by which its effect on the room is found [rad or m]."""
_MOST = 60
"""Steps of `FINE`; most bodies are parted within ten."""


def parted(robot: RobotModel, space: Space, exact: ExactClearance, start: Array, enough_m: float) -> Array:
    """A way along which the tightest pair parts, by the steepest ascent of its room.

    Args:
        robot: its joint limits are kept.
        space: in which the way lies.
        exact: measures.
        start: (n,) where it begins, in the space.
        enough_m: room at which it ends.

    Returns:
        (P, n) configurations, `start` first, neighbours no further apart than `FINE` in the free joints. It ends
        earlier where no joint parts the bodies any more; with `start` alone if there is room, or no way to any.
    """
    way, room_m = [start], exact.measure(start).room_m
    while room_m < enough_m and len(way) < _MOST:
        rates = _rates(space, exact, way[-1], room_m)
        if not rates.any():
            break
        target = way[-1][space.free] + FINE * rates / np.abs(rates).max()
        q = _reached(space, way[-1], np.clip(target, robot.lower[space.free], robot.upper[space.free]))
        if q is None or (q < robot.lower).any() or (q > robot.upper).any():
            break
        if np.abs(q - way[-1]).max() > LEAP * FINE or (gained_m := exact.measure(q).room_m) <= room_m:
            break
        way.append(q)
        room_m = gained_m
    return np.array(way)


def _rates(space: Space, exact: ExactClearance, q: Array, room_m: float) -> Array:
    """(m,) gain of room per unit of each free joint; zero where the hands cannot be kept."""
    rates = np.zeros(len(space.free))
    for index, offset in enumerate(_PROBED * np.eye(len(space.free))):
        probed = _reached(space, q, q[space.free] + offset)
        if probed is not None:
            rates[index] = (exact.measure(probed).room_m - room_m) / _PROBED
    return rates


def _reached(space: Space, q: Array, target: Array) -> Array | None:
    """Where straight motion of the free joints to (m,) ends; None if there is no way."""
    reached: Array = space.walk(q[None], target[None], 1)[0, -1]
    return None if np.isnan(reached).any() else reached
