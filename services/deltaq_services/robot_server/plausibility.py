"""Which positions in a telegram can be true: that a digit can be read is no reason to believe it.

A KRC's telegram has no checksum beyond UDP's, and anybody on the network can write one. A position is
believed if it lies where the robot can be, and no further from the last one than the joints can have moved since.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from deltaq_cell.description import RobotDescription

LIMIT_MARGIN_RAD = 0.35
LIMIT_MARGIN_M = 0.2
"""How far outside its limits a joint may be reported. A cell's limits lie inside those of the robot, and an operator
may have jogged it there; a robot further out is not driven."""

VELOCITY_MARGIN = 1.5
"""How much faster than its limit a joint may be reported to move: servos overshoot, telegrams are not evenly apart."""

RESOLUTION_RAD = 0.0035
RESOLUTION_M = 0.0002
"""Rounding of two telegrams: a controller with one decimal rounds to 0.1 deg or mm."""


@dataclass(frozen=True, slots=True)
class PositionFault:
    """Why a reported position is not believed: which joint, what is wrong, the value and its bound [rad or m]."""

    joint: str
    what: str
    value: float
    bound: float

    def __str__(self) -> str:
        return f"{self.joint} {self.what}: {self.value:.6g}, allowed {self.bound:.6g} (rad or m)"


@dataclass(frozen=True, slots=True)
class Plausibility:
    """Bounds of plausible positions and motions of one robot's joints, each (n,) [rad or m].

    Attributes:
        joints: names, for messages.
        lower: least position that is believed.
        upper: greatest position that is believed.
        reach: largest motion of a joint in one cycle.
        resolution: rounding of a distance by the telegram's decimals.
    """

    joints: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    reach: tuple[float, ...]
    resolution: tuple[float, ...]

    @classmethod
    def of(cls, robot: RobotDescription, cycle_s: float) -> Plausibility:
        """The bounds of a robot with sample time `cycle_s`."""
        margin = [LIMIT_MARGIN_RAD if unit == "rad" else LIMIT_MARGIN_M for unit in robot.units]
        return cls(
            robot.joint_names,
            tuple((robot.lower - margin).tolist()),
            tuple((robot.upper + margin).tolist()),
            tuple((VELOCITY_MARGIN * cycle_s * robot.max_velocity).tolist()),
            tuple(RESOLUTION_RAD if unit == "rad" else RESOLUTION_M for unit in robot.units),
        )

    def of_place(self, q: Sequence[float]) -> PositionFault | None:
        """Why no robot can be at `q` (n,) [rad or m], or None."""
        for joint, value, lower, upper in zip(self.joints, q, self.lower, self.upper, strict=True):
            if not value >= lower:
                return PositionFault(joint, "is below its limit and a margin", value, lower)
            if not value <= upper:
                return PositionFault(joint, "is above its limit and a margin", value, upper)
        return None

    def of_motion(self, q: Sequence[float], last: Sequence[float], cycles: int) -> PositionFault | None:
        """Why a robot that was at `last` cannot be at `q` (n,) [rad or m] that many cycles later, or None."""
        for number, joint in enumerate(self.joints):
            bound = cycles * self.reach[number] + self.resolution[number]
            distance = abs(q[number] - last[number])
            if not distance <= bound:
                return PositionFault(joint, f"cannot have moved so far in {cycles} cycles", distance, bound)
        return None
