"""The gate's decision on one request: how much of it can still be braked without harm.

A request is blended with the brake, `dq(s) = (1 - s) * brake + s * request`, with the largest s found for which
the tube of `dq(s)` and the brake after it keeps I1 (position limits), I2 (clearance) and I3 (velocity and
acceleration). The brake itself was certified with the last admission, so s = 0 is always available (I4).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.description import ContactDescription, GateDescription
from deltaq_cell.group import Nearest
from deltaq_cell.proximity import ProximityEngine
from deltaq_cell.reach import apart_m
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import NearestPair, Outcome, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.certificate import NUMERICAL_TOLERANCE_M, Binding, Certificate
from deltaq_services.sim.compiled_certificate import SHARE_BUDGET, Blend, CompiledCertifier
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.retreat import Retreat, Violations
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import Windows


class Contacts:
    """The pairs of bodies that are not kept apart: those of allowed contacts, and those of tools that are not there.

    At the start no contact is allowed, and every exchangeable tool may be there.

    Args:
        proximity: of the cell; it measures no such pair.
        contacts: of the cell, by name.
        tool_bodies: names of the bodies of all exchangeable tools.

    Attributes:
        allowed: names of the contacts allowed now, in the cell's order.
        absent: bodies of tools that are not there.
    """

    def __init__(
        self,
        proximity: ProximityEngine,
        contacts: Mapping[str, ContactDescription],
        tool_bodies: frozenset[str] = frozenset(),
    ) -> None:
        self._proximity = proximity
        self._contacts = contacts
        self._tool_bodies = tool_bodies
        self.allowed: tuple[str, ...] = ()
        self.absent: frozenset[str] = frozenset()

    def __contains__(self, name: object) -> bool:
        """Whether the cell has such a contact."""
        return name in self._contacts

    def allow(self, names: Iterable[str]) -> None:
        """Allow these contacts and forbid all others."""
        wanted = set(names)
        self._proximity.leave_out_bodies(self._tool_bodies, left_out=False)
        for contact in self._contacts.values():
            self._proximity.leave_out(contact.pairs, left_out=False)
        self.allowed = tuple(name for name in self._contacts if name in wanted)
        for name in self.allowed:
            self._proximity.leave_out(self._contacts[name].pairs)
        self._proximity.leave_out_bodies(self.absent)

    def without(self, absent: frozenset[str]) -> None:
        """Measure no pair of these bodies of tools, and those of all other tools."""
        if absent != self.absent:
            self.absent = absent
            self.allow(self.allowed)

    def switch(self, name: str, allowed: bool) -> None:
        """Allow one contact, or forbid it."""
        self.allow({*self.allowed, name} if allowed else {*self.allowed} - {name})

    def speed(self, robot: str) -> tuple[float, str]:
        """Fraction of its velocity limits that a robot may use now, and the contact that sets it, "" if none does."""
        shares = [
            (self._contacts[name].speed, name)
            for name in self.allowed
            if self._contacts[name].concerns(robot)
        ]
        return min(shares, default=(1.0, ""))


class SlowDown:
    """Speed and separation: the nearer two bodies are, the slower they may approach one another.

    Within the band between the stop distance and `slow_down_distance_m` the approach speed that is allowed falls in
    proportion to the room that is left, as in speed and separation monitoring. It is counted along the line between the
    nearest points, from this robot's own motion; of two robots each has half. The invariants do not rest on it: it
    makes motion near bodies gentle, not safe.

    Args:
        proximity: of the cell.
        margins: the gate's.
        cycle_s: sample time of its robots.
    """

    def __init__(self, proximity: CompiledProximity, margins: GateDescription, cycle_s: float) -> None:
        self._proximity = proximity
        self._distance_m = margins.slow_down_distance_m
        self._fastest = margins.slow_down_speed_m_s * cycle_s
        self._cycle_s = cycle_s

    def scale(
        self, robot: Tracker, others: Sequence[Tracker], brake: Array, request: Array, at_most: float
    ) -> tuple[float, list[Reason]]:
        """Largest s <= `at_most` with which no pair in the band approaches too fast, and the reason if it is less.

        Args:
            robot: the robot that is to move, judged at the setpoint that the increment is added to.
            others: the other robots, at their present setpoints.
            brake: (n,) next increment of the brake [rad or m].
            request: (n,) requested increment [rad or m].
            at_most: the largest s that other limits leave.
        """
        if self._distance_m is None:
            return at_most, []
        self._place(robot.name, robot.ahead.q_cmd)
        # of two robots each has half of the speed
        lists = [(1.0, self._proximity.alone[robot.name])]
        for other in others:
            self._place(other.name, other.q_cmd)
            lists.append((0.5, self._proximity.between[robot.name, other.name]))
        scale, reasons = at_most, []
        near = [
            (share, approach)
            for share, groups in lists
            if groups
            for approach in self._proximity.approaches(robot.name, groups, self._distance_m)
        ]
        for share, approach in near:
            room = (approach.distance_m - approach.stop_distance_m) / (
                self._distance_m - approach.stop_distance_m
            )
            allowed = share * self._fastest * max(room, 0.0)
            before, change = approach.per_joint @ brake, approach.per_joint @ (request - brake)
            if change <= 0.0 or before + scale * change <= allowed:
                continue
            scale = max(float((allowed - before) / change), 0.0)
            reasons = [
                Reason(
                    code=ReasonCode.SLOW_DOWN,
                    what=" ".join(approach.pair),
                    value=float(before + at_most * change) / self._cycle_s,
                    bound=allowed / self._cycle_s,
                )
            ]
        return scale, reasons

    def _place(self, robot: str, q: Array) -> None:
        self._proximity.place(robot, q, np.zeros_like(q))


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
        reasons: the limiting factors of the request, tightest first.
        binding: the pair of bodies with the least clearance to spare; None without one.
    """

    outcome: Outcome
    scale: float
    dq: Array
    brake_cycles: int
    reasons: tuple[Reason, ...]
    binding: Binding | None


class Gate:
    """Decides requests by bodies and limits, without clocks or links.

    Args:
        proximity: measures the cell's bodies.
        limits: joint limits of each robot for one cycle, by robot.
        margins: the cell's gate margins.
        contacts: the allowed contacts.
        violations: distances that pairs in a violation have to keep.
    """

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
            # a retreat gets at most the share that the limits left, so they bound a full one
            bound = reasons if scale == left else []
            reasons = [*bound, *violated] or [_clearance_reason(certificate)]
        return _decision(limits, brake, request, scale, reasons, certificate.binding)

    def _in_reach(self, robot: Tracker, other: Tracker) -> bool:
        """Whether any of their bodies can come as near as the stop distance, in any configuration."""
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


def verdict_of(
    robot: str, cycle: int, setpoint_cycle: int, seq: int, decision: Decision, cycle_s: float
) -> Verdict:
    """A decision on the increment `seq` and the state of `cycle`, for the setpoint of `setpoint_cycle`."""
    near = decision.binding.nearest if decision.binding is not None else None
    return Verdict(
        robot=robot,
        cycle=cycle,
        seq=seq,
        outcome=decision.outcome,
        setpoint_cycle=None if decision.outcome is Outcome.HELD else setpoint_cycle,
        scale=decision.scale,
        dq=tuple(decision.dq.tolist()),
        time_to_stop_s=decision.brake_cycles * cycle_s,
        reasons=decision.reasons,
        clearance_m=near.distance_m if near is not None else None,
        pair=near.pair if near is not None else None,
    )


def nearest_pair(near: Nearest) -> NearestPair:
    """Two bodies with their witness points."""
    first, second = (tuple(point.tolist()) for point in near.points_m)
    return NearestPair(pair=near.pair, distance_m=near.distance_m, points_m=(first, second))
