"""A motion along a path of configurations, as increments: speeds up, moves, and slows down within a robot's limits.

Pure: setpoints go in, increments come out. The gate still judges each of them.
"""

import math

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError, RefusedError
from deltaq_protocol.messages import Outcome, Reason, RobotState, RobotSummary, Verdict
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode

_STRAIGHT = 0.7
"""Share of a joint's greatest acceleration with which a motion speeds up and slows down; the rest is a reserve."""
_CURVED = 0.2
"""Share of a joint's greatest acceleration that the curvature of the path may need."""
_PATIENCE_S = 0.5
"""A motion that the gate keeps in its place for so long has failed [s]."""
_ARRIVED = 1e-9
"""Distance to the end of the path, which has the length 1, at which the end is reached."""
REACHED = 1e-6
"""Distance to the end at which a setpoint is there [rad or m]."""
_SPEED_UNITS = {
    ReasonCode.POSITION_LIMIT: "",
    ReasonCode.VELOCITY_LIMIT: "/s",
    ReasonCode.ACCELERATION_LIMIT: "/s²",
}
"""What follows a joint's unit in the value of a reason."""
_REMEDIES = {
    ReasonCode.POSITION_LIMIT: "move the joint the other way",
    ReasonCode.VELOCITY_LIMIT: "send a smaller increment",
    ReasonCode.ACCELERATION_LIMIT: "change the increment by less from cycle to cycle",
    ReasonCode.CLEARANCE: "move the other way, or along another path",
    ReasonCode.RETREAT: "move the two bodies apart, slowly",
    ReasonCode.SLOW_DOWN: "approach more slowly",
    ReasonCode.CONTACT: "move slowly, or forbid the contact: `deltaq contact NAME --forbid`",
    ReasonCode.STOPPED: "when the cause is gone and it is safe: `deltaq reset`",
    ReasonCode.NOT_READY: "`deltaq status` shows which service is missing",
}
"""What to do about a reason; the page on troubleshooting has the others."""
_PASSING = (
    *(ReasonCode.STALE_CYCLE, ReasonCode.FUTURE_CYCLE, ReasonCode.SUPERSEDED, ReasonCode.LATE),
    *(ReasonCode.NOT_READY, ReasonCode.LEASE_NOT_HELD),
)
"""Reasons for which one increment is refused and the next may pass."""


class InvalidMotionError(DeltaqError, ValueError):
    """A target, a speed or an increment that no robot of that kind can be asked for."""


class MotionError(RefusedError):
    """A motion or increment was limited, held or refused.

    Attributes:
        code: the reason, one of `deltaq_protocol.reasons.ReasonCode`.
        what: the joint or the pair of bodies that the reason names.
        value: the requested value [rad, m or their rates]; None if the reason has none.
        bound: the allowed value, in the unit of `value`.
    """

    def __init__(
        self, message: str, reason: Reason | None, hint: str = "", summary: RobotSummary | None = None
    ) -> None:
        reason = reason or Reason(code=ReasonCode.UNREACHABLE)  # no verdict and no state said why
        self.what, self.value, self.bound = reason.what, reason.value, reason.bound
        hint = hint or _REMEDIES.get(reason.code, "")
        super().__init__(reason.code.value, f"{message}: {_told(reason, summary)}", hint)


def checked(robot: str, verdict: Verdict, summary: RobotSummary | None = None) -> Verdict:
    """Return the verdict if the whole increment was admitted; raise otherwise.

    Args:
        robot: name of the robot.
        verdict: the gate's answer to the increment.
        summary: the robot's joints and their units, for the error's message.

    Raises:
        MotionError: it was limited, held or refused, or no verdict came.
    """
    if verdict.outcome is Outcome.ADMITTED:
        return verdict
    reason = verdict.reasons[0] if verdict.reasons else None
    raise MotionError(f"the increment of {robot} was {verdict.outcome.value}", reason, summary=summary)


def held(state: RobotState) -> MotionError:
    """The error for a robot that is held."""
    reason = None if state.reason is None else Reason(code=state.reason)
    remedy = f"when the cause is gone and it is safe, `deltaq reset --robot {state.robot}`"
    return MotionError(f"{state.robot} is held", reason, remedy)


def _told(reason: Reason, summary: RobotSummary | None) -> str:
    unit = " m" if reason.code is ReasonCode.CLEARANCE else ""
    if summary is not None and reason.what in summary.joints and reason.code in _SPEED_UNITS:
        unit = f" {summary.units[summary.joints.index(reason.what)]}{_SPEED_UNITS[reason.code]}"
    value = "" if reason.value is None else f" {reason.value:.4g}{unit}"
    bound = "" if reason.bound is None else f" (bound {reason.bound:.4g}{unit})"
    return f"{EXPLANATIONS[reason.code]}: {reason.what}{value}{bound}".rstrip(" :")


def joint_path(robot: str, summary: RobotSummary, start: Array, target: Array) -> Array:
    """The straight line in joint space from `start` to `target`, both (n,) [rad or m], as a path (2, n).

    Raises:
        ValueError: the target has another length, is not finite, or lies beyond a joint's limit.
    """
    if target.shape != start.shape:
        raise InvalidMotionError(f"{robot} has {len(start)} joints, the target has the shape {target.shape}")
    for index, name in enumerate(summary.joints):
        lower, upper, unit = summary.lower[index], summary.upper[index], summary.units[index]
        if not lower <= target[index] <= upper:
            raise InvalidMotionError(
                f"target of joint {name}: {target[index]:.6g} {unit} is not from {lower:.6g} to {upper:.6g}"
            )
    return np.stack([start, target])


class Motion:
    """One motion of a robot along a path.

    Args:
        robot: name of the robot.
        path: (m + 1, n) configurations at equal steps of the path's length, m >= 1 [rad or m].
        summary: the robot's limits.
        cycle_s: of the robot [s].
        speed: share of each joint's greatest velocity that the motion may use, above 0, at most 1.

    Raises:
        ValueError: the speed is out of its range.
    """

    def __init__(
        self, robot: str, path: Array, summary: RobotSummary, cycle_s: float, speed: float = 0.2
    ) -> None:
        if not 0.0 < speed <= 1.0:
            raise InvalidMotionError(
                f"speed: {speed:.6g} is not above 0 and at most 1 (share of the joints' velocities)"
            )
        self._robot, self._path, self._summary = robot, path, summary
        segments = len(path) - 1
        velocity = np.maximum(np.abs(np.diff(path, axis=0)).max(axis=0) * segments, 1e-12)
        bend = np.zeros_like(velocity)
        if segments > 1:
            bend = np.abs(np.diff(path, 2, axis=0)).max(axis=0) * segments**2
        fastest = speed * np.array(summary.max_velocity) / velocity
        acceleration = np.array(summary.max_acceleration)
        curved = np.sqrt(_CURVED * acceleration / np.maximum(bend, 1e-12))
        self._most = float(min(fastest.min(), curved.min())) * cycle_s
        self._step = float((_STRAIGHT * acceleration / velocity).min()) * cycle_s**2
        self._nudge = _STRAIGHT * acceleration * cycle_s**2
        self._patience_cycles = max(2, round(_PATIENCE_S / cycle_s))
        self._at, self._pace, self._cycle = 0.0, 0.0, -1
        self._stood = 0
        self._reason: Reason | None = None

    @property
    def end(self) -> Array:
        """(n,) the configuration at which the motion ends [rad or m]."""
        end: Array = self._path[-1]
        return end

    def take(self, verdict: Verdict) -> None:
        """Take the verdict on one of the motion's increments.

        Raises:
            MotionError: it was refused for a reason that does not pass.
        """
        if verdict.reasons:
            self._reason = verdict.reasons[0]
            if verdict.outcome is Outcome.REFUSED and self._reason.code not in _PASSING:
                checked(self._robot, verdict, self._summary)

    def increment(self, cycle: int, q_cmd: Array) -> Array | None:
        """The increment (n,) after the setpoint `q_cmd` (n,) of a cycle; None when that is the path's end [rad or m].

        Raises:
            MotionError: the robot has not come forward for half a second.
        """
        place = self._place(q_cmd)
        cycles = max(1, cycle - self._cycle) if self._cycle >= 0 else 1
        self._pace = min(self._pace, max(0.0, place - self._at) / cycles + self._step)
        self._stood = self._stood + cycles if place <= self._at and self._cycle >= 0 else 0
        self._at, self._cycle = place, cycle
        left = 1.0 - place
        off = self.end - q_cmd
        if left <= _ARRIVED and np.abs(off).max() < REACHED:
            return None
        if self._stood > self._patience_cycles:
            raise MotionError(
                f"{self._robot} stopped with {1.0 - place:.0%} of its path left",
                self._reason,
                summary=self._summary,
            )
        if left <= _ARRIVED:  # beyond the end, or beside it: a setpoint that was not known had been sent
            back: Array = off * min(1.0, float((self._nudge / np.maximum(np.abs(off), 1e-12)).min()))
            return back
        # the greatest pace from which it can slow down before the end: pace + pace**2 / (2 step) - pace / 2 <= left
        slowing = self._step * (math.sqrt(0.25 + 2.0 * left / self._step) - 0.5)
        self._pace = min(self._pace + self._step, self._most, slowing, left)
        dq: Array = self._point(place + self._pace) - q_cmd
        return dq

    def _point(self, place: float) -> Array:
        """The configuration at a place of the path, from 0 to 1."""
        if place >= 1.0 - _ARRIVED:
            return self.end
        segment, rest = divmod(place * (len(self._path) - 1), 1.0)
        before, after = self._path[int(segment)], self._path[int(segment) + 1]
        point: Array = before + rest * (after - before)
        return point

    def _place(self, q_cmd: Array) -> float:
        """The place on the path nearest to a setpoint, not before the last one."""
        segments = len(self._path) - 1
        first = min(int(self._at * segments), segments - 1)
        best, nearest = self._at, math.inf
        for segment in range(first, min(first + 8, segments)):
            along = self._path[segment + 1] - self._path[segment]
            length = float(along @ along)
            # a segment without length ends where it begins: a robot may be asked to go where it is
            rest = 1.0 if length == 0.0 else float((q_cmd - self._path[segment]) @ along) / length
            rest = min(1.0, max(0.0, rest))
            off = float(np.abs(self._path[segment] + rest * along - q_cmd).max())
            if off < nearest - 1e-12:
                best, nearest = (segment + rest) / segments, off
        return max(self._at, best)
