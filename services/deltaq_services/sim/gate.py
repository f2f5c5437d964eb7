"""The gate's decision on one request: how much of it can still be braked without harm.

A request is blended with the brake, `dq(s) = (1 - s) * brake + s * request`, with the largest s found for which
the tube of `dq(s)` and the brake after it keeps I1 (position limits), I2 (clearance) and I3 (velocity and
acceleration). The brake itself was certified with the last admission, so s = 0 is always available (I4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.description import GateDescription
from deltaq_cell.reach import apart_m
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome, Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.blend import Blend
from deltaq_services.sim.certificate import NUMERICAL_TOLERANCE_M, Binding, Certificate
from deltaq_services.sim.compiled_certificate import SHARE_BUDGET, CompiledCertifier
from deltaq_services.sim.contacts import Contacts
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.retreat import Retreat
from deltaq_services.sim.slow_down import SlowDown
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import Windows
from deltaq_services.sim.violations import Violations

_LEAST_SCALE = 1e-3
"""Below this a blend is the brake in all but name."""


@dataclass(frozen=True)
class Decision:
    """The gate's answer to one request.

    Attributes:
        outcome: admitted, scaled or held.
        scale: s of the blend.
        dq: (n,) increment admitted; the brake's if held.
        brake_cycles: length of the brake after it.
        reasons: what limited the request, tightest first.
        binding: the pair of bodies with the least room.
    """

    outcome: Outcome
    scale: float
    dq: Array
    brake_cycles: int
    reasons: tuple[Reason, ...]
    binding: Binding | None


class Gate:
    """Decides requests; knows the bodies and the limits, and nothing of clocks or links."""

    def __init__(
        self,
        proximity: CompiledProximity,
        limits: dict[str, Limits],
        margins: GateDescription,
        contacts: Contacts,
        violations: Violations,
    ) -> None:
        self._proximity = proximity
        self._least_apart_m = margins.stop_distance_m + NUMERICAL_TOLERANCE_M
        self._apart_at_zero = {
            frozenset((one, other))
            for one, other in combinations(limits, 2)
            if apart_m(proximity.reach[one], proximity.reach[other]) > self._least_apart_m
        }
        self._limits = limits
        self._contacts = contacts
        self._violations = violations
        self._retreat = Retreat(proximity, margins, violations)
        self._slow_down = SlowDown(proximity, margins, next(iter(limits.values())).cycle_s)

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        """Decide one request.

        Args:
            robot: the robot that is to move, with a known state.
            others: the other robots with known states.
            request: (n,) finite increment [rad or m].
        """
        limits = self._limits[robot.name]
        brake = robot.brake()
        scale, reasons = limits.scale(brake, request, robot.ahead.dq, robot.ahead.q_cmd)
        share, contact = self._contacts.speed(robot.name)
        if contact and (slow := limits.slow_scale(brake, request, share)) < scale:
            scale, reasons = slow, [Reason(code=ReasonCode.CONTACT, what=contact, bound=share)]
        scale, tighter = self._slow_down.scale(robot, others, brake, request, scale)
        reasons = tighter or reasons
        near = [other for other in others if self._in_reach(robot, other)]
        tubes = [(other.name, tube) for other in near for tube in other.tubes()]
        blend = Blend(robot, limits, brake, request, scale)
        certificate = CompiledCertifier(self._proximity).certify(robot.name, blend.tube(scale), tubes)
        if certificate.holds:
            self._violations.only(robot.name, ())
        elif self._stands_clear(robot, tubes):
            self._violations.only(robot.name, ())
            # all smaller scales share one budget, so that a decision ends in time
            certifier = CompiledCertifier(self._proximity, SHARE_BUDGET, tells=False)
            scale = certifier.largest(blend, tubes, scale, certificate)
            reasons = [_clearance_reason(certificate)]
        else:
            left = scale
            scale, violated = self._retreat.find(robot, near, limits, brake, request, left)
            # what the limits left is all that retreat may take, so that they bound it if it takes all
            bound = reasons if scale == left else []
            reasons = [*bound, *violated] or [_clearance_reason(certificate)]
        return _decision(limits, brake, request, scale, reasons, certificate.binding)

    def _in_reach(self, robot: Tracker, other: Tracker) -> bool:
        """Whether any of their bodies can come as near as the stop distance, whatever their joints do."""
        if frozenset((robot.name, other.name)) not in self._apart_at_zero:
            return True
        reaches = self._proximity.reach[robot.name], self._proximity.reach[other.name]
        return apart_m(*reaches, (robot.farthest(), other.farthest())) <= self._least_apart_m

    def _stands_clear(self, robot: Tracker, tubes: Sequence[tuple[str, Windows]]) -> bool:
        """Whether a robot that is sent nothing more keeps clear of all tubes."""
        certifier = CompiledCertifier(self._proximity, tells=False)
        return certifier.certify(robot.name, robot.standing(), tubes).holds


def _decision(
    limits: Limits, brake: Array, request: Array, scale: float, reasons: list[Reason], binding: Binding | None
) -> Decision:
    if scale >= 1.0:
        return Decision(Outcome.ADMITTED, 1.0, request, limits.brake_cycles(request), (), binding)
    if scale < _LEAST_SCALE:
        return Decision(Outcome.HELD, 0.0, brake, limits.brake_cycles(brake), tuple(reasons), binding)
    dq = brake + scale * (request - brake)
    return Decision(Outcome.SCALED, scale, dq, limits.brake_cycles(dq), tuple(reasons), binding)


def _clearance_reason(certificate: Certificate) -> Reason:
    binding = certificate.binding
    assert binding is not None  # a failed certificate names its pair
    return Reason(
        code=ReasonCode.CLEARANCE,
        what=" ".join(binding.nearest.pair),
        value=binding.nearest.swept_m,
        bound=binding.stop_distance_m,
    )
