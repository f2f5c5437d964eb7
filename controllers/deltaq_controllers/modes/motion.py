"""What an operator commands: rates of joints and of hands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from deltaq_protocol.arrays import Array

HAND_AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Axes of a hand: along x, y, z [m/s] and about them [rad/s]."""


class ModeName(StrEnum):
    """The modes of Hooper & Noakes, Table 1, in their order."""

    JOINT = "joint"
    DECOUPLED = "decoupled"
    SELF_MOTION = "self-motion"
    ADVISOR = "advisor"
    COUPLED = "coupled"


class Frame(StrEnum):
    """The axes in which a hand is moved."""

    WORLD = "world"
    TOOL = "tool"


class Grip(StrEnum):
    """Whether hands move by themselves, or hold one object together."""

    FREE = "free"
    OBJECT = "object"


@dataclass(frozen=True)
class OperatorCommand:
    """The operator's command of this cycle; an empty command is a released stick.

    Attributes:
        rates: by axis: a joint's name [rad/s or m/s], an axis of all hands (`x`, `rz`), or of one of several
            hands (`left.x`) [m/s, rad/s]. Hands that hold an object move as it does: `x` is the object's.
        mode: the mode from now on; None does not change it.
        frame: the axes from now on; None does not change them.
        option: rank of the advisor's option to go to; None is rest, also on the path to it.
        outputs: digital outputs to switch now, by name; the others do not change.
        grip: whether all hands hold an object from now on; None does not change it.
    """

    rates: Mapping[str, float] = field(default_factory=dict)
    mode: ModeName | None = None
    frame: Frame | None = None
    option: int | None = None
    outputs: Mapping[str, bool] = field(default_factory=dict)
    grip: Grip | None = None


@dataclass(frozen=True)
class Motion:
    """Rates of all joints and all hands; a mode uses the rates of what it drives.

    Attributes:
        joints: (n,) joint rates [rad/s or m/s].
        hands: (h, 6) velocity [m/s] and angular velocity [rad/s] of each hand, world axes.
        along: pace along a path; 1 follows its time parameterisation.
    """

    joints: Array
    hands: Array
    along: float = 0.0

    @classmethod
    def rest(cls, joints: int, hands: int) -> Motion:
        """No motion."""
        return cls(np.zeros(joints), np.zeros((hands, 6)))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of joints and of hands."""
        return len(self.joints), len(self.hands)

    def __bool__(self) -> bool:
        return bool(self.joints.any() or self.hands.any() or self.along)

    def scaled(self, share: float) -> Motion:
        """All rates times `share`."""
        return Motion(share * self.joints, share * self.hands, share * self.along)

    def towards(self, other: Motion, share: float) -> Motion:
        """The motion between this one and `other`, at fraction `share`."""
        rest = 1.0 - share
        return Motion(
            rest * self.joints + share * other.joints,
            rest * self.hands + share * other.hands,
            rest * self.along + share * other.along,
        )
