"""The interface of a mode."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.modes.conditioning import LOST
from deltaq_controllers.modes.hands import Hands, HeldObject
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode
from deltaq_protocol.messages import Outcome, Verdict
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode


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


# What limits the operator now, in words: from the mode's own conditioning, its limits, and the gate's verdict.


class Limit(StrEnum):
    """Kinds of things that limit a mode."""

    JOINT_LIMIT = "limit"
    SINGULARITY = "singularity"
    WORKSPACE_EDGE = "workspace_edge"
    CLEARANCE = "clearance"
    SPEED = "speed"
    NO_WAY = "no_way"
    REFUSED = "refused"


@dataclass(frozen=True)
class Limitation:
    """One limiting factor of a mode.

    Attributes:
        limit: its kind.
        what: the joint, hand or pair of bodies concerned.
        text: a sentence for the operator.
    """

    limit: Limit
    what: str
    text: str


_FROM_GATE = {
    ReasonCode.POSITION_LIMIT: Limit.JOINT_LIMIT,
    ReasonCode.VELOCITY_LIMIT: Limit.SPEED,
    ReasonCode.ACCELERATION_LIMIT: Limit.SPEED,
    ReasonCode.CLEARANCE: Limit.CLEARANCE,
    ReasonCode.RETREAT: Limit.CLEARANCE,
}


def from_verdict(verdict: Verdict) -> Limitation | None:
    """The limitation of a request by the gate; None if it was admitted."""
    if verdict.outcome is Outcome.ADMITTED or not verdict.reasons:
        return None
    reason = verdict.reasons[0]
    limit = _FROM_GATE.get(reason.code, Limit.REFUSED)
    what = reason.what if limit is not Limit.REFUSED else reason.code.value
    text = EXPLANATIONS[reason.code]
    if limit is Limit.CLEARANCE and reason.value is not None and reason.bound is not None:
        text += f": {what}, {reason.value * 1000:.0f} mm, allowed {reason.bound * 1000:.0f} mm"
    elif what:
        text += f": {what}"
    return Limitation(limit, what, text)


def of_joint(name: str, position: float, revolute: bool) -> Limitation:
    """A joint at its limit: with more motion it could not be braked inside the limit."""
    where = f"{np.rad2deg(position):.1f}°" if revolute else f"{position * 1000:.0f} mm"
    return Limitation(Limit.JOINT_LIMIT, name, f"{name} is at its limit, {where}")


def of_speed(name: str) -> Limitation:
    """The limitation by a joint's velocity limit."""
    return Limitation(Limit.SPEED, name, f"{name} is at its velocity limit")


def of_pair(pair: tuple[str, str], distance_m: float, kept_m: float) -> Limitation:
    """Two bodies that come no nearer."""
    what = " and ".join(pair)
    text = f"{what} come no nearer: {distance_m * 1000:.0f} mm, kept {kept_m * 1000:.0f} mm"
    return Limitation(Limit.CLEARANCE, what, text)


def of_object(limitation: Limitation) -> Limitation:
    """The limitation of hands that hold an object, which stops with them."""
    return replace(limitation, text=f"the object, held by all hands: {limitation.text}")


class Conditioning(NamedTuple):
    """A commanded direction near a singularity.

    Attributes:
        rates: (r,) of the tasks that are asked for, turns as travel, six for each hand first [m/s].
        motion: (n,) direction in which the joints would have to move.
        bend: (r,) change along it of the tasks' displacements per joint displacement [m/rad^2].
        mobility: of the direction [m/rad].
        lost: part of the direction that no joint motion makes.
    """

    rates: Array
    motion: Array
    bend: Array
    mobility: float
    lost: float


def of_conditioning(hands: Hands, conditioning: Conditioning) -> Limitation:
    """A singularity, or the edge of the workspace.

    At an edge the reach is greatest: the hands' second derivative along the motion of the joints points back inside.
    This is checked where travel is asked for; lost rotations are singularities of the wrist.
    """
    way = conditioning.rates[: 6 * len(hands.names)]
    busy = [float(np.linalg.norm(conditioning.motion[arm])) for arm in hands.arms]
    asked = [float(np.linalg.norm(part)) for part in way.reshape(-1, 6)]
    # of equally busy arms the one whose hand is asked to move
    hand = int(np.argmax([busy[i] * (asked[i] > 0.0) for i in range(len(busy))]))
    name = hands.names[hand]
    size = float(np.linalg.norm(conditioning.rates))
    travel = float(np.linalg.norm(way.reshape(-1, 6)[:, :3])) / size
    bend = float(conditioning.rates @ conditioning.bend) / size
    if conditioning.lost > LOST:
        text = f"the {name} is at a singularity: no joint motion moves it in that direction"
        return Limitation(Limit.SINGULARITY, name, text)
    told = f"{1000.0 * conditioning.mobility:.0f} mm of travel for each radian of the joints"
    if travel > _MOSTLY and bend < -_BENT:
        return Limitation(Limit.WORKSPACE_EDGE, name, f"the {name} is at the edge of its reach ({told})")
    return Limitation(Limit.SINGULARITY, name, f"the {name} is at a singularity ({told})")


_MOSTLY = 0.7
"""Fraction of travel in a way that makes it one of travel."""

_BENT = 0.05
"""Second derivative of the reach that counts as an edge [m/rad^2]."""


@dataclass(frozen=True)
class Instant:
    """A robot's configuration in a cycle, and the bounds of its next increment.

    Attributes:
        q_cmd: (n,) setpoint that the increment is added to [rad or m].
        dq_last: (n,) increment that led to it [rad or m].
        dq_before: (n,) the one before that [rad or m].
        limits: of the increments.
        max_jerk: (n,) greatest change of an increment's change; infinite for no limit [rad or m].
        cycle_s: the cycle [s].
        surroundings: bodies that the robot keeps clear of by itself; None leaves that to the gate.
        held: the object that the hands keep between them; None for hands that are free.
    """

    q_cmd: Array
    dq_last: Array
    dq_before: Array
    limits: IncrementLimits
    max_jerk: Array
    cycle_s: float
    surroundings: RobotSurroundings | None = None
    held: HeldObject | None = None


class Advance(NamedTuple):
    """An increment, and its limiting factor.

    Attributes:
        dq: (n,) increment [rad or m].
        limitation: the limiting factor; None without one.
    """

    dq: Array
    limitation: Limitation | None = None


class TeleoperationMode(Protocol):
    """Turns a motion of joints and hands into joint displacements.

    Attributes:
        drives_joints: (n,) which joints an operator drives by name.
    """

    drives_joints: NDArray[np.bool_]

    @property
    def name(self) -> DrivingMode:
        """As in `--mode`."""
        ...

    @property
    def drives_hands(self) -> bool:
        """Whether an operator drives the hands."""
        ...

    @property
    def status(self) -> str:
        """Status for the operator, beside what limits the mode."""
        return ""

    @property
    def arrived_at(self) -> int | None:
        """The option at which the robot rests; None elsewhere."""
        return None

    @property
    def awaits_advice(self) -> bool:
        """Whether the option that was chosen is still being looked for, or a path to it."""
        return False

    def stand_in(self) -> TeleoperationMode:
        """The mode that `practise` runs in place of this one; itself, unless it would start work elsewhere."""
        return self

    def enter(self, q: Array) -> None:
        """Start this mode with the robot at rest at `q` (n,)."""
        del q

    def leave(self) -> None:
        """Another mode takes over."""
        return

    def choose(self, option: int | None) -> None:
        """Set the option that is commanded in this cycle."""
        del option

    def advance(self, instant: Instant, asked: Motion, /) -> Advance:
        """The increment of this cycle towards a requested motion; zero at rest without a request."""
        ...
