"""Which RSI axis each joint is, and how its unit is converted.

The one place where degrees and millimetres turn into rad and m.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError, ProtocolError

KrcGeneration = Literal["krc2", "krc4"]
JointUnit = Literal["rad", "m"]

DEG_PER_RAD = 180.0 / math.pi
MM_PER_M = 1000.0

ARM_AXES = tuple(f"A{i}" for i in range(1, 7))
EXTERNAL_AXES = tuple(f"E{i}" for i in range(1, 7))
POSE_AXES = ("X", "Y", "Z", "A", "B", "C")


@dataclass(frozen=True)
class AxisMap:
    """The joints of a robot in our order, each named after its RSI axis: `a1` … `a6`, `e1` … `e6`.

    Attributes:
        joints: names of the joints, in the order of every vector that a codec takes or returns.
        units: `rad` or `m` for each joint; arm axes are revolute.
        krc: the controller. A KR C2 reports a linear external axis as mm times 180/pi, though it is
            commanded in mm; a KR C4 uses mm both ways.

    Raises:
        EthernetConfigError: if a joint is no RSI axis, comes twice, or has the wrong unit.
    """

    joints: tuple[str, ...]
    units: tuple[JointUnit, ...]
    krc: KrcGeneration = "krc4"

    def __post_init__(self) -> None:
        if len(self.joints) != len(self.units):
            raise EthernetConfigError(
                f"{len(self.joints)} joints but {len(self.units)} units: give one unit for each joint"
            )
        for joint, unit in zip(self.joints, self.units, strict=True):
            if re.fullmatch(r"[ae][1-6]", joint) is None or self.joints.count(joint) > 1:
                raise EthernetConfigError(
                    f"joint {joint!r} is no RSI axis or comes twice; "
                    "allowed are a1 … a6 and e1 … e6, each once"
                )
            if unit not in ("rad", "m") or (joint[0] == "a" and unit != "rad"):
                raise EthernetConfigError(
                    f"joint {joint!r} has unit {unit!r}; allowed are rad, and m for external axes"
                )

    @classmethod
    def of(cls, joints: Sequence[str], units: Sequence[JointUnit], krc: KrcGeneration) -> AxisMap:
        """The map of a robot description: `AxisMap.of(robot.joint_names, robot.units, robot.driver.krc)`."""
        return cls(tuple(joints), tuple(units), krc)

    def __len__(self) -> int:
        return len(self.joints)

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """RSI's name of each joint."""
        return tuple(joint.upper() for joint in self.joints)

    @cached_property
    def commanded(self) -> Array:
        """(n,) deg or mm of a correction per rad or m."""
        return np.array([DEG_PER_RAD if unit == "rad" else MM_PER_M for unit in self.units])

    @cached_property
    def reported(self) -> Array:
        """(n,) units of a reported position (deg or mm; a KR C2 may scale them) per rad or m."""
        linear = MM_PER_M * DEG_PER_RAD if self.krc == "krc2" else MM_PER_M
        return np.array([DEG_PER_RAD if unit == "rad" else linear for unit in self.units])


class EthernetConfigError(DeltaqError):
    """A `*_ethernet.xml` that cannot be used; the message names file, element, value and what is allowed."""


class TelegramError(ProtocolError):
    """A datagram that is no telegram of this configuration, or a value that no telegram can carry."""
