"""The motion of one tool as the wish for another one. Pure: what is seen is handed in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from deltaq_protocol.arrays import Array

PULL_1_S = 4.0
"""Rate at which the rest of the way is made up [1/s]."""
SLACK_M, SLACK_RAD = 0.05, 0.2
"""The hand is pulled by no more: where it could not follow, the master's way back moves it at once [m, rad]."""
SMOOTHED_S = 0.05
"""Time constant of the measured twist [s]."""
JUMP_M, JUMP_RAD = 0.1, 0.5
"""A master that is so far off from one look to the next has not moved there [m, rad]."""


class PlacedTool(NamedTuple):
    """The pose of a tool.

    Attributes:
        rotation: (3, 3) its axes in the world.
        position: (3,) its origin in the world [m].
    """

    rotation: Array
    position: Array


@dataclass
class _Anchor:
    """Where both were as they were coupled; the hand's moves along where it cannot follow.

    Attributes:
        axes: (3, 3) takes the master's way and turn to those of the hand.
    """

    master: PlacedTool
    hand: PlacedTool
    axes: Array


class LedPose:
    """Leads a hand by a master's tool: its way since they were coupled, scaled, is the hand's.

    Displacements are scaled, rotations are not. Both are in world axes, or with `own_axes` each in those that its tool
    had then.

    Args:
        scale: way of the hand for each metre of the master's.
    """

    def __init__(self, scale: float) -> None:
        self._scale = scale
        self._anchor: _Anchor | None = None
        self._seen: tuple[float, PlacedTool] | None = None
        self._twist: Array = np.zeros(6)

    @property
    def is_coupled(self) -> bool:
        """Whether the hand is led."""
        return self._anchor is not None

    def release(self) -> None:
        """Lead the hand no more."""
        self._anchor = self._seen = None
        self._twist = np.zeros(6)

    def couple(self, master: PlacedTool, hand: PlacedTool, own_axes: bool) -> None:
        """Lead the hand from where both are now.

        Args:
            master: its tool, as measured.
            hand: that is led, as commanded.
            own_axes: the master's way in the axes of its tool is the hand's in its own.
        """
        self.release()
        self._anchor = _Anchor(master, hand, hand.rotation @ master.rotation.T if own_axes else np.eye(3))

    def twist(self, time_s: float, master: PlacedTool, hand: PlacedTool) -> Array | None:
        """The twist (6,) that is wished of the hand, world axes [m/s, rad/s]; None if the master jumped.

        Args:
            time_s: stamp of the master's pose on its own clock [s].
            master: its tool, as measured.
            hand: that is led, as commanded.
        """
        anchor = self._anchor
        assert anchor is not None  # coupled
        if not self._measure(time_s, master):
            self.release()
            return None
        way = self._scale * (anchor.axes @ (master.position - anchor.master.position))
        turn = pin.exp3(anchor.axes @ pin.log3(master.rotation @ anchor.master.rotation.T))
        left = _clipped(anchor.hand.position + way - hand.position, SLACK_M)
        askew = _clipped(pin.log3(turn @ anchor.hand.rotation @ hand.rotation.T), SLACK_RAD)
        # what is beyond the slack is given up
        anchor.hand = PlacedTool(turn.T @ pin.exp3(askew) @ hand.rotation, hand.position + left - way)
        ahead = np.concatenate([self._scale * (anchor.axes @ self._twist[:3]), anchor.axes @ self._twist[3:]])
        wished: Array = ahead + PULL_1_S * np.concatenate([left, askew])
        return wished

    def _measure(self, time_s: float, master: PlacedTool) -> bool:
        """Take a pose of the master into its twist; whether it can have moved there."""
        if self._seen is None:
            self._seen = time_s, master
            return True
        before_s, before = self._seen
        if time_s <= before_s:
            return time_s == before_s
        moved = np.concatenate(
            [master.position - before.position, pin.log3(master.rotation @ before.rotation.T)]
        )
        if np.linalg.norm(moved[:3]) > JUMP_M or np.linalg.norm(moved[3:]) > JUMP_RAD:
            return False
        step_s = time_s - before_s
        follows = 1.0 - math.exp(-step_s / SMOOTHED_S)
        self._twist = self._twist + follows * (moved / step_s - self._twist)
        self._seen = time_s, master
        return True


def _clipped(vector: Array, size: float) -> Array:
    return vector * min(1.0, size / max(float(np.linalg.norm(vector)), 1e-12))
