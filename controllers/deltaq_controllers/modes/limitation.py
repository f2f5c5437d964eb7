"""What limits the operator now, in words: from the mode's own conditioning, its limits, and the gate's verdict."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.resolved_rate import WEAK, Inverse
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome, Verdict
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode


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
    """One thing that limits a mode now.

    Attributes:
        limit: its kind.
        what: the joint, hand or pair of bodies.
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
    """What limited a request at the gate; None if it was admitted."""
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
    """A joint that would have to move faster than it can."""
    return Limitation(Limit.SPEED, name, f"{name} is at its velocity limit")


def of_conditioning(hands: Hands, inverse: Inverse, wanted: Array, q: Array) -> Limitation | None:
    """A direction that the hands have lost, if the operator asks for it.

    The Jacobian's weakest direction is lost at an edge of the workspace and at singularities inside it. At an edge
    the reach is greatest: the hands' second derivative along the weak joint direction points back inside. This is
    checked where the lost direction is one of travel; lost rotations are singularities of the wrist.

    Args:
        hands: placed at `q`.
        inverse: of their Jacobian there.
        wanted: (6 h,) displacement that is asked for [m, rad].
        q: (n,) configuration [rad or m].
    """
    if inverse.weakest >= WEAK:
        return None
    lost = inverse.left[-1]
    hand = int(np.argmax([np.linalg.norm(lost[6 * i : 6 * i + 6]) for i in range(len(hands.names))]))
    asked = np.linalg.norm(inverse.left @ wanted)
    share = float(lost @ wanted)
    if asked == 0.0 or abs(share) < 0.1 * asked:
        return None
    name = hands.names[hand]
    size = f"smallest singular value {inverse.weakest:.3f} m/rad"
    travel = float(np.linalg.norm(lost.reshape(-1, 6)[:, :3]))
    if travel > _MOSTLY and _is_edge(hands, inverse, share, q):
        return Limitation(Limit.WORKSPACE_EDGE, name, f"the {name} is at the edge of its reach ({size})")
    return Limitation(Limit.SINGULARITY, name, f"the {name} is at a singularity ({size})")


_MOSTLY = 0.7
"""Fraction of travel in a lost direction, a unit vector, that makes it a direction of travel."""

_BENT = 0.05
"""Second derivative of the reach that counts as an edge [m/rad^2]."""


def _is_edge(hands: Hands, inverse: Inverse, share: float, q: Array) -> bool:
    lost, joints = inverse.left[-1], inverse.right[-1]
    step = 1e-4
    hands.update(q + step * joints)
    ahead = hands.jacobian @ joints
    hands.update(q - step * joints)
    behind = hands.jacobian @ joints
    hands.update(q)
    bend = float(lost @ (ahead - behind)) / (2.0 * step)
    return bend * share < 0.0 and abs(bend) > _BENT
