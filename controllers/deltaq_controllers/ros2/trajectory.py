"""A trajectory as a robot can follow it: a message that was checked against the robot's joints and limits."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.ros2.messages import RefusedMessageError
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import RobotSummary

# A path through points in time: cubic where both ends of a piece have velocities, straight where not.
#
# So does the spline interpolation of `joint_trajectory_controller` ("Trajectory Representation" of its documentation),
# whose third kind, quintic where accelerations are given as well, is not here.


_Pieces = NDArray[np.intp]


class Path:
    """A continuous path in joint space over its own time, which begins at 0.

    Args:
        times_s: (m,) of the points, increasing from 0 [s].
        q: (m, n) positions [rad or m].
        velocities: (m, n) [rad/s or m/s]; a row that is not a number has none.

    Attributes:
        times_s: as given.
        duration_s: of the path [s].
    """

    def __init__(self, times_s: Array, q: Array, velocities: Array) -> None:
        self.times_s = times_s
        self.duration_s = float(times_s[-1])
        length_s, moved = np.diff(times_s)[:, None], np.diff(q, axis=0)
        begin, end = velocities[:-1], velocities[1:]
        is_cubic = np.isfinite(begin) & np.isfinite(end)
        mean = moved / length_s
        # Hermite's cubic by powers of the time since the piece began
        square = (3.0 * mean - 2.0 * begin - end) / length_s
        cube = (begin + end - 2.0 * mean) / length_s**2
        self._powers = (
            q[:-1],
            np.where(is_cubic, begin, mean),
            np.where(is_cubic, square, 0.0),
            np.where(is_cubic, cube, 0.0),
        )

    def at(self, times_s: Array) -> Array:
        """(k, n) positions at times (k,), which are kept within the path [rad or m]."""
        return self._position(*self._since(times_s))

    def velocity(self, times_s: Array) -> Array:
        """(k, n) velocities at times (k,) by the path's own time [rad/s or m/s]."""
        return self._velocity(*self._since(times_s))

    def acceleration(self, times_s: Array) -> Array:
        """(k, n) accelerations at times (k,) by the path's own time [rad/s^2 or m/s^2]."""
        piece, since = self._since(times_s)
        _, _, square, cube = (power[piece] for power in self._powers)
        acceleration: Array = 2.0 * square + 6.0 * since * cube
        return acceleration

    def corners(self) -> Array:
        """(m, n) by how much the velocity jumps at each point; the robot rests before the first and behind the last."""
        lengths_s = np.diff(self.times_s)[:, None]
        pieces = np.arange(len(self.times_s) - 1)
        begin, end = self._powers[1], self._velocity(pieces, lengths_s)
        rest = np.zeros((1, begin.shape[1]))
        jumps: Array = np.concatenate([begin, rest]) - np.concatenate([rest, end])
        return jumps

    def extremes(self) -> tuple[Array, Array, Array]:
        """Of each piece and joint the least and greatest position and the greatest speed, three of (m - 1, n)."""
        lengths_s = np.diff(self.times_s)[:, None]
        _, dq, square, cube = self._powers
        pieces = np.arange(len(lengths_s))
        with np.errstate(divide="ignore", invalid="ignore"):
            fastest_s = -square / (3.0 * cube)
            root = np.sqrt(square**2 - 3.0 * cube * dq)
            turning_s = [
                (-square + root) / (3.0 * cube),
                (-square - root) / (3.0 * cube),
                -dq / (2.0 * square),
            ]
        ends_s = [np.zeros_like(dq), np.broadcast_to(lengths_s, dq.shape)]
        places_s = [*ends_s, *(np.clip(np.nan_to_num(at_s), 0.0, lengths_s) for at_s in turning_s)]
        positions = np.array([self._position(pieces, at_s) for at_s in places_s])
        fast_s = [*ends_s, np.clip(np.nan_to_num(fastest_s), 0.0, lengths_s)]
        speeds = np.abs([self._velocity(pieces, at_s) for at_s in fast_s])
        return positions.min(axis=0), positions.max(axis=0), speeds.max(axis=0)

    def _since(self, times_s: Array) -> tuple[_Pieces, Array]:
        """The piece of each time (k,), and the time since it began (k, 1)."""
        within = np.clip(times_s, 0.0, self.duration_s)
        piece = np.clip(np.searchsorted(self.times_s, within, side="right") - 1, 0, len(self.times_s) - 2)
        return piece, (within - self.times_s[piece])[:, None]

    def _position(self, piece: _Pieces, since: Array) -> Array:
        q, dq, square, cube = (power[piece] for power in self._powers)
        position: Array = q + since * (dq + since * (square + since * cube))
        return position

    def _velocity(self, piece: _Pieces, since: Array) -> Array:
        _, dq, square, cube = (power[piece] for power in self._powers)
        velocity: Array = dq + since * (2.0 * square + 3.0 * since * cube)
        return velocity


MAX_DURATION_S = 600.0
"""Of a trajectory, by its own times [s]."""

STAMP_WITHIN_S = 5.0
"""A header's stamp, unless it is 0, is at most so far from now [s]: trajectories begin when they come, not later."""

START_WITHIN = {"rad": 0.02, "m": 0.005}
"""How far from the robot's setpoint a first point with `time_from_start` 0 may be, by the joint's unit [rad, m]."""

_SHOWN = 256
"""Characters of an unknown name in its refusal."""

_NANOSECONDS = 10**9

_ROUNDING = 1e-6
"""Tolerance relative to a limit: a trajectory exactly at a limit is allowed."""

_AT_REST = 1e-3
"""Share of a joint's greatest speed that counts as rest at the end."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Points in the robot's joint order, at least one; an empty message asks for a stop and is none.

    Attributes:
        times_s: (m,) from the start, increasing from 0 or more [s].
        q: (m, n) positions [rad or m].
        velocities: (m, n), rows that were not given are not numbers [rad/s or m/s].
    """

    times_s: Array
    q: Array
    velocities: Array

    @property
    def duration_s(self) -> float:
        """By its own times [s]."""
        return float(self.times_s[-1])


def read_trajectory(message: Any, robot: RobotSummary, now_ns: int) -> Trajectory | None:
    """The trajectory that a message requests of a robot; None: to stop.

    Args:
        message: a `trajectory_msgs/msg/JointTrajectory`, as received.
        robot: its joints and limits.
        now_ns: time since the epoch [ns].

    Raises:
        RefusedMessageError: for the first thing that is wrong, with field, value and bound.
    """
    _check_stamp(message.header.stamp, now_ns)
    if not message.points:
        return None
    order = _joint_order(message.joint_names, robot.joints)
    n = len(order)
    rows = [_rows(point, f"points[{k}]", n) for k, point in enumerate(message.points)]
    q = np.array([positions for positions, _ in rows])[:, order]
    velocities = np.array([given or [math.nan] * n for _, given in rows])[:, order]
    trajectory = Trajectory(_times_s(message.points), q, velocities)
    _check_limits(trajectory, robot)
    return trajectory


def path_from(trajectory: Trajectory, q_cmd: Array, robot: RobotSummary) -> Path:
    """The path of a robot that rests at a setpoint.

    A first point later than 0 is reached from there in its time. One at 0 has to be near: it is approached on a
    straight line at half speed at most, and the times of all points are counted from there.

    Args:
        trajectory: to be followed.
        q_cmd: (n,) the robot's setpoint [rad or m].
        robot: its joints and limits.

    Raises:
        RefusedMessageError: it begins too far away, or leads there too fast or beyond a limit.
    """
    times_s, q, velocities = trajectory.times_s, trajectory.q, trajectory.velocities
    rest = np.zeros((1, len(q_cmd)))
    if times_s[0] == 0.0:
        away = np.abs(q[0] - q_cmd)
        _check_start(away, robot)
        lead_in_s = float((2.0 * away / np.array(robot.max_velocity)).max())
        if len(q) > 1 and not away.any():
            path = Path(times_s, q, velocities)
            _check_path(path, robot, 1)
            return path
        times_s = times_s + max(lead_in_s, _ROUNDING)
        rest = np.full_like(rest, math.nan)  # without a velocity the way there is straight
    path = Path(
        np.concatenate([[0.0], times_s]),
        np.concatenate([[q_cmd], q]),
        np.concatenate([rest, velocities]),
    )
    _check_path(path, robot, 0)
    return path


def _check_stamp(stamp: Any, now_ns: int) -> None:
    time_s = _seconds(stamp, "header.stamp")
    away_s = time_s - now_ns / 1e9
    if time_s and abs(away_s) > STAMP_WITHIN_S:
        bound = f"0, or within {STAMP_WITHIN_S:g} s of now: a trajectory begins when it comes"
        raise RefusedMessageError("time", "header.stamp", f"{away_s:+.3f} s from now", bound)


def _seconds(time: Any, name: str) -> float:
    """Seconds of a `builtin_interfaces/msg/Time` or `Duration`."""
    if time.nanosec >= _NANOSECONDS:
        raise RefusedMessageError("time", f"{name}.nanosec", time.nanosec, f"less than {_NANOSECONDS}")
    return float(time.sec + time.nanosec / _NANOSECONDS)


def _joint_order(given: Sequence[str], joints: tuple[str, ...]) -> list[int]:
    """Where each joint of the robot is among those that were given."""
    seen: set[str] = set()
    for k, name in enumerate(given):
        if name in seen:
            raise RefusedMessageError(
                "joint_names", f"joint_names[{k}]", f"{name!r} again", "each joint once"
            )
        if name not in joints:
            shown = repr(name[:_SHOWN])
            raise RefusedMessageError("joint_names", f"joint_names[{k}]", shown, ", ".join(joints))
        seen.add(name)
    if missing := [name for name in joints if name not in seen]:
        raise RefusedMessageError(
            "joint_names", "joint_names", f"without {', '.join(missing)}", f"all of {', '.join(joints)}"
        )
    return [given.index(name) for name in joints]


def _rows(point: Any, name: str, n: int) -> tuple[list[float], list[float]]:
    """Positions and velocities of a point; velocities are empty where there are none."""
    rows = {
        field: getattr(point, field).tolist()
        for field in ("positions", "velocities", "accelerations", "effort")
    }
    for field, values in rows.items():
        if len(values) != n and (values or field == "positions"):
            bound = f"{n}, one for each joint" + ("" if field == "positions" else ", or 0")
            raise RefusedMessageError("length", f"{name}.{field}", f"of length {len(values)}", bound)
        for k, value in enumerate(values):
            if not math.isfinite(value):
                raise RefusedMessageError("not_finite", f"{name}.{field}[{k}]", value, "a finite number")
    return rows["positions"], rows["velocities"]


def _times_s(points: Sequence[Any]) -> Array:
    before_s, times_s = -math.inf, []
    for k, point in enumerate(points):
        name = f"points[{k}].time_from_start"
        time_s = _seconds(point.time_from_start, name)
        if not 0.0 <= time_s <= MAX_DURATION_S:
            raise RefusedMessageError("time", name, f"{time_s:g} s", f"0 to {MAX_DURATION_S:g} s")
        if time_s <= before_s:
            bound = f"more than the {before_s:.9g} s of the point before"
            raise RefusedMessageError("time", name, f"{time_s:.9g} s", bound)
        before_s = time_s
        times_s.append(time_s)
    return np.array(times_s)


def _check_limits(trajectory: Trajectory, robot: RobotSummary) -> None:
    """Check the points; the path between them is checked when the start is known."""
    last = f"points[{len(trajectory.q) - 1}]"
    for joint, unit in enumerate(robot.units):
        lower, upper = robot.lower[joint], robot.upper[joint]
        for k, q in enumerate(trajectory.q[:, joint].tolist()):
            if not lower <= q <= upper:
                what = f"points[{k}].positions, {robot.joints[joint]},"
                raise RefusedMessageError("limit", what, f"{q:g} {unit}", f"{lower:g} to {upper:g} {unit}")
        speed, slow = abs(trajectory.velocities[-1, joint]), _AT_REST * robot.max_velocity[joint]
        if speed > slow:
            what = f"{last}.velocities, {robot.joints[joint]},"
            bound = f"rest at the end, {slow:g} {unit}/s or less"
            raise RefusedMessageError("limit", what, f"{speed:g} {unit}/s", bound)


def _check_start(away: Array, robot: RobotSummary) -> None:
    for joint, unit in enumerate(robot.units):
        if away[joint] > START_WITHIN[unit]:
            what = f"points[0].positions, {robot.joints[joint]},"
            given = f"{away[joint]:.4g} {unit} from the robot's setpoint"
            bound = f"{START_WITHIN[unit]:g} {unit} or less at time_from_start 0"
            raise RefusedMessageError("start", what, given, bound)


def _check_path(path: Path, robot: RobotSummary, first: int) -> None:
    """Check a path between its points; `first` is the point of the message that its first piece leads to."""
    least, greatest, fastest = path.extremes()
    for joint, unit in enumerate(robot.units):
        name, fastest_allowed = robot.joints[joint], robot.max_velocity[joint]
        most = int(fastest[:, joint].argmax())
        if fastest[most, joint] > fastest_allowed * (1.0 + _ROUNDING):
            given, bound = f"{fastest[most, joint]:.4g} {unit}/s", f"{fastest_allowed:g} {unit}/s or less"
            raise RefusedMessageError(
                "limit", f"the speed towards points[{most + first}], {name},", given, bound
            )
        slack = _ROUNDING * (robot.upper[joint] - robot.lower[joint])
        for places, k in ((least, least[:, joint].argmin()), (greatest, greatest[:, joint].argmax())):
            q = places[k, joint]
            if not robot.lower[joint] - slack <= q <= robot.upper[joint] + slack:
                bound = f"{robot.lower[joint]:g} to {robot.upper[joint]:g} {unit}"
                what = f"the way to points[{int(k) + first}], {name},"
                raise RefusedMessageError("limit", what, f"at {q:.4g} {unit}", bound)
