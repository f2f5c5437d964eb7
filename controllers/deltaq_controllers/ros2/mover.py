"""The trajectories that ROS requests of a robot: one is driven at a time, and the newest goes first.

Pure: messages, states and verdicts are handed in, with the time where it matters.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

import numpy as np

from deltaq_controllers.interface import LastIncrement, RobotView, View
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.ros2.messages import RefusedMessageError, decoded_trajectory
from deltaq_controllers.ros2.rmw import RosAttachment
from deltaq_controllers.ros2.trajectory import START_WITHIN, Path, Trajectory, path_from, read_trajectory
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome, Phase, Reason, RobotState, RobotSummary, Verdict

# Follow a path cycle by cycle: requests stay on it, and the motion slows down where less is admitted.


# The speed profile of a path, so that the robot can slow down in time for bends and the end.

SHARE = 0.7
"""Share of the joints' acceleration limits that a bend or a corner of the path may take."""

_BRAKED = 0.9
"""Share of the acceleration for bends and for slowing down, together."""

_MOST_PLACES = 20_000
_CYCLES_BEFORE = 2.0


class RateProfile:
    """The greatest rate at each place of a path: 1 drives it in its own time, less stretches the time.

    With the path's own time s and x = (ds/dt)^2 a joint's acceleration is q'' x + q' (dx/ds) / 2. Bends bound x by
    `SHARE`, the rest bounds how quickly x may fall. At a corner of a path of straight pieces the rate is such that one
    cycle's change of the increment suffices, so that the path is kept there too.

    Args:
        path: to be driven.
        limits: of the robot's increments.
        cycle_s: of the robot.
    """

    def __init__(self, path: Path, limits: IncrementLimits, cycle_s: float) -> None:
        with np.errstate(divide="ignore"):
            jump = np.minimum(1.0, (SHARE * limits.max_ddq / cycle_s / np.abs(path.corners())).min(axis=1))
        # the robot has slowed down for a corner before the cycle in which it passes it
        before_s = np.maximum(path.times_s - _CYCLES_BEFORE * cycle_s * jump, 0.0)
        spacing_s = max(cycle_s, path.duration_s / _MOST_PLACES)
        regular_s = np.arange(0.0, path.duration_s, spacing_s)
        self._places_s = np.unique(np.concatenate([regular_s, path.times_s, before_s]))
        max_acceleration = limits.max_ddq / cycle_s**2
        # a bend counts in the whole piece between two places: what is least of both its ends
        between_s = np.diff(self._places_s)
        inside = np.stack([self._places_s[:-1] + 1e-3 * between_s, self._places_s[1:] - 1e-3 * between_s])
        speed = np.abs([path.velocity(at_s) for at_s in inside]).max(axis=0)
        bend = np.abs([path.acceleration(at_s) for at_s in inside]).max(axis=0)
        with np.errstate(divide="ignore"):
            driven = np.minimum(1.0, (SHARE * max_acceleration / bend).min(axis=1))
            fall = ((_BRAKED * max_acceleration - driven[:, None] * bend) / speed).min(axis=1)
        most = np.minimum(np.append(driven, 1.0), np.append(1.0, driven))
        for at_s in (path.times_s, before_s):
            np.minimum.at(most, np.searchsorted(self._places_s, at_s), jump**2)
        self._squares = _reachable(most.tolist(), (2.0 * between_s * fall).tolist())

    def rate(self, times_s: Array) -> Array:
        """(k,) the greatest rate at times (k,) of the path."""
        rates: Array = np.sqrt(np.interp(times_s, self._places_s, self._squares))
        return rates

    def places_between(self, begin_s: float, end_s: float) -> Array:
        """(k,) times of the path within these two between which the rate does not bend."""
        first, last = np.searchsorted(self._places_s, (begin_s, end_s))
        return self._places_s[first:last]


def _reachable(most: list[float], falls: list[float]) -> Array:
    """From the end backwards: no place may be passed faster than the next one can be slowed down to."""
    reachable = most[-1:]
    for bound, fall in zip(reversed(most[:-1]), reversed(falls), strict=True):
        reachable.append(min(bound, reachable[-1] + fall))
    return np.array(reachable[::-1])


BLOCKED_S = 2.0
"""A robot that has made no way along its path for so long is not waited for [s]."""

_PARTS = 8
_ROUNDS = 4
"""A place is found to within a part in `_PARTS ** _ROUNDS`, or a quarter of it."""
_TAKEN_BACK_CYCLES = 20.0
"""Cycles in which a deviation is corrected: a brake of the gate is straight, a path may bend."""
_TAKEN_BACK_AT_LEAST = 0.1
"""Of the greatest change of an increment."""
_SEARCHED_S = 0.5
"""How far from where it was last the robot is looked for, back and ahead, by the path's time [s]."""
_SEARCHED = 1025
_NEARER_IN_TIME = 0.01
"""Of two places on a path that crosses itself the one nearer in time counts: a cycle is so many greatest increments."""
_LAST_CYCLES = 2.0
"""A path may begin or pass where it ends: the end is the end only in its last cycles."""
_PROGRESS_S = 1e-4
"""Way along the path that counts as some [s of its time]."""
_ARRIVED = 1e-6
"""Share of a joint's greatest increment by which it may miss the end."""


class TrajectoryEnding(StrEnum):
    """How a trajectory ended."""

    ARRIVED = "arrived"
    STOPPED = "stopped"
    BLOCKED = "blocked"
    OFF_PATH = "off_path"


class TrajectoryFollower:
    """Makes the increments of one trajectory, which begins at the robot's rest position.

    Args:
        trajectory: to be followed.
        q_cmd: (n,) setpoint of the robot [rad or m].
        robot: its joints and limits.
        cycle_s: of the cell.

    Raises:
        RefusedMessageError: the trajectory cannot be begun from there.

    Attributes:
        ending: how it ended; None while it is driven. From then on the increments are zero.
    """

    def __init__(self, trajectory: Trajectory, q_cmd: Array, robot: RobotSummary, cycle_s: float) -> None:
        self.ending: TrajectoryEnding | None = None
        self.path: Path = path_from(trajectory, q_cmd, robot)
        self._limits = IncrementLimits.told(robot, cycle_s)
        self._profile = RateProfile(self.path, self._limits, cycle_s)
        self._last = LastIncrement(self._limits.max_ddq)
        self._within = np.array([START_WITHIN[unit] for unit in robot.units])
        self._cycle_s = cycle_s
        self._at_s = self._sent_to_s = self._farthest_s = 0.0
        self._idle_cycles = 0
        self._stops = False

    def stop(self) -> None:
        """Come to rest on the path, as soon as the limits allow, and end there."""
        self._stops = True

    def increment(self, view: View) -> Array:
        """The increment for this cycle (n,), zero after the end [rad or m]."""
        own = view.own
        dq_last = self._last.update(own)
        dq = self._wanted(own, dq_last) if self.ending is None else np.zeros_like(own.q_cmd)
        return self._limits.admissible(dq, own.q_cmd, dq_last)

    def _wanted(self, own: RobotView, dq_last: Array) -> Array:
        here = self._find(own.q_cmd)
        deviation = own.q_cmd - here
        self._ends(own, deviation, dq_last)
        back = here + self._taken_back(deviation)
        self._sent_to_s = self._at_s + self._step_s(back, dq_last)
        return self._to(self._sent_to_s) - back

    def _taken_back(self, deviation: Array) -> Array:
        """The part of a deviation (n,) that a cycle corrects: a fraction of it, or all of a small one."""
        least = _TAKEN_BACK_AT_LEAST * self._limits.max_ddq
        small = np.minimum(np.maximum(deviation, -least), least)
        share = deviation / _TAKEN_BACK_CYCLES
        return np.where(np.abs(share) > np.abs(small), share, small)

    def _step_s(self, back: Array, dq_last: Array) -> float:
        """How far to go along the path: as far as profile and joints allow or, to come to rest, as little as they do.

        Where the profile asks for less than the joints can do, the joints' limits go first: the robot stays on its
        path.
        """

        def excess(steps_s: Array) -> Array:
            dq = self.path.at(self._at_s + steps_s) - back
            shares = np.abs(dq - dq_last) / self._limits.max_ddq, np.abs(dq) / self._limits.max_dq
            return np.asarray(np.maximum(*shares).max(axis=1))

        def is_possible(steps_s: Array) -> Array:
            return np.asarray(excess(steps_s) <= 1.0)

        most_s = min(self._cycle_s, self.path.duration_s - self._at_s)
        in_profile_s = self._in_profile_s(most_s)
        if not self._stops and in_profile_s == most_s and is_possible(np.array([most_s]))[0]:
            return most_s
        possible_s = _least(excess, 0.0, most_s)
        if not is_possible(np.array([possible_s]))[0]:
            return possible_s
        slowest_s = _edge(is_possible, possible_s, 0.0)
        if self._stops:
            return slowest_s
        fastest_s = _edge(is_possible, possible_s, most_s)
        return max(slowest_s, min(fastest_s, in_profile_s))

    def _in_profile_s(self, most_s: float) -> float:
        """How far the next step may go by the profile, which may have a narrow place within a step."""

        def holds(steps_s: Array) -> Array:
            return np.asarray(steps_s <= self._cycle_s * self._profile.rate(self._at_s + steps_s))

        narrow_s = self._profile.places_between(self._at_s, self._at_s + most_s) - self._at_s
        steps_s = np.sort(np.concatenate([np.linspace(0.0, most_s, _PARTS + 1), narrow_s]))
        does = holds(steps_s)
        if does.all():
            return most_s
        first = max(1, int(does.argmin()))
        return _edge(holds, float(steps_s[first - 1]), float(steps_s[first]))

    def _to(self, time_s: float) -> Array:
        place: Array = self.path.at(np.array([time_s]))[0]
        return place

    def _find(self, q_cmd: Array) -> Array:
        """The place on the path (n,) where the robot is now: where it was sent to or, if not there, the nearest one."""
        sent_to = self._to(self._sent_to_s)
        if (np.abs(sent_to - q_cmd) <= _ARRIVED * self._limits.max_dq).all():
            self._at_s = self._sent_to_s
            return sent_to
        near_s = np.linspace(self._at_s - _SEARCHED_S, self._at_s + _SEARCHED_S, _SEARCHED)
        near_s = np.clip(near_s, 0.0, self.path.duration_s)
        distances = self._distances(near_s, q_cmd)
        k = int(distances.argmin())
        lower_s, upper_s = near_s[max(k - 1, 0)], near_s[min(k + 1, _SEARCHED - 1)]
        self._at_s = _least(lambda at_s: self._distances(at_s, q_cmd), float(lower_s), float(upper_s))
        return self._to(self._at_s)

    def _distances(self, times_s: Array, q_cmd: Array) -> Array:
        away = (self.path.at(times_s) - q_cmd) / self._limits.max_dq
        late = _NEARER_IN_TIME * (times_s - self._sent_to_s) / self._cycle_s
        distances: Array = (away**2).sum(axis=1) + late**2
        return distances

    def _ends(self, own: RobotView, deviation: Array, dq_last: Array) -> None:
        """Whether the trajectory has ended: see `TrajectoryEnding`."""
        rests = bool((np.abs(dq_last) <= _ARRIVED * self._limits.max_dq).all())
        from_end = np.abs(own.q_cmd - self._to(self.path.duration_s))
        is_last = self.path.duration_s - self._at_s <= _LAST_CYCLES * self._cycle_s
        if self._at_s > self._farthest_s + _PROGRESS_S:
            self._farthest_s, self._idle_cycles = self._at_s, 0
        else:
            self._idle_cycles += 1
        if (np.abs(deviation) > self._within).any():
            self.ending = TrajectoryEnding.OFF_PATH
        elif rests and is_last and (from_end <= _ARRIVED * self._limits.max_dq).all():
            self.ending = TrajectoryEnding.ARRIVED
        elif rests and self._stops:
            self.ending = TrajectoryEnding.STOPPED
        elif self._idle_cycles * self._cycle_s > BLOCKED_S:
            self.ending = TrajectoryEnding.BLOCKED


def _least(cost: Callable[[Array], Array], lower_s: float, upper_s: float) -> float:
    """The minimum of a cost that first falls and then rises."""
    for _ in range(_ROUNDS):
        places_s = np.linspace(lower_s, upper_s, _PARTS + 1)
        k = int(cost(places_s).argmin())
        lower_s, upper_s = float(places_s[max(k - 1, 0)]), float(places_s[min(k + 1, _PARTS)])
    return float(places_s[k])


def _edge(holds: Callable[[Array], Array], inside_s: float, outside_s: float) -> float:
    """How far from `inside_s`, where it holds, towards `outside_s` it holds."""
    for _ in range(_ROUNDS):
        places_s = np.linspace(inside_s, outside_s, _PARTS + 1)
        does = holds(places_s)
        if does.all():
            return outside_s
        first = max(1, int(does.argmin()))
        inside_s, outside_s = float(places_s[first - 1]), float(places_s[first])
    return inside_s


TrajectoryNews = Callable[[str, Mapping[str, Any]], None]
"""Logs an event, with fields for programs."""

_NOTHING = 1e-9
"""Less than that is no difference of setpoints [rad or m]."""
_LONGEST_REST_S = 2.0
"""After the end of a trajectory its last increments are waited for no longer [s]."""
_MAY_NOT_MOVE = (Phase.HELD, Phase.OFFLINE)


class TrajectoryMover:
    """Moves one robot along the trajectories that come for it.

    A new one takes the place of the one that is driven: the robot comes to rest on its path and begins the new one
    there. An empty one only brings it to rest. What ends a trajectory also ends the one that waits behind it, unless
    the robot has come to rest on the path for that.

    Args:
        name: of the robot.
        robot: its joints and limits.
        cycle_s: of the cell.
        say: takes a text about every event.
        counters: trajectories and stops that were taken, refusals by kind, and endings are counted here.
    """

    def __init__(
        self,
        name: str,
        robot: RobotSummary,
        cycle_s: float,
        say: TrajectoryNews,
        counters: Counter[str] | None = None,
    ) -> None:
        self.counters: Counter[str] = Counter() if counters is None else counters
        self._name, self._robot, self._cycle_s, self._say = name, robot, cycle_s, say
        self._waiting: Trajectory | None = None
        self._driven: TrajectoryFollower | None = None
        self._limited_by: tuple[Reason, ...] = ()
        self._resting_cycles = 0
        self._q_cmd: Array | None = None

    @property
    def has_work(self) -> bool:
        """Whether a trajectory waits or is driven: the robot's lease is needed for it."""
        return self._waiting is not None or self._driven is not None

    def hear(self, message: bytes, attachment: bytes | None, now_ns: int) -> None:
        """Take a message, from any sender; `now` is in ns since the epoch."""
        try:
            RosAttachment.decode(attachment)
            trajectory = read_trajectory(decoded_trajectory(message), self._robot, now_ns)
        except RefusedMessageError as error:
            self._refuse(error)
            return
        if trajectory is None:
            self.counters["stops"] += 1
            self._tell("an empty trajectory arrived: the robot comes to rest", event="stop")
        else:
            self.counters["trajectories"] += 1
            self._tell(
                f"a trajectory of {len(trajectory.q)} points and {trajectory.duration_s:g} s came",
                event="trajectory",
                points=len(trajectory.q),
                duration_s=trajectory.duration_s,
            )
        self._waiting = trajectory
        if self._driven is not None:
            self._driven.stop()

    def increment(self, state: RobotState, view: View) -> Array:
        """The increment that answers a state, (n,) [rad or m].

        Args:
            state: the robot's newest.
            view: the robot's view, with all increments in flight.
        """
        if state.phase in _MAY_NOT_MOVE:
            self.lose(f"the robot is {state.phase}" + (f": {state.reason}" if state.reason else ""))
        stands = self._q_cmd is not None and np.abs(view.own.q_cmd - self._q_cmd).max() <= _NOTHING
        self._q_cmd = view.own.q_cmd
        if (
            self._driven is None and self._waiting is not None and stands
        ):  # another client's brake may still go on
            self._begin(self._waiting, view.own.q_cmd)
        if self._driven is None:
            return np.zeros(len(self._robot.joints))
        dq = self._driven.increment(view)
        if self._driven.ending is not None and self._rests(state, view):
            self._end(self._driven.ending)
        return dq

    def _rests(self, state: RobotState, view: View) -> bool:
        """Whether no increment is in flight: releasing the lease earlier would discard it."""
        self._resting_cycles += 1
        in_flight = np.abs(view.own.q_cmd - np.array(state.q_cmd)).max()
        return bool(in_flight <= _NOTHING) or self._resting_cycles * self._cycle_s > _LONGEST_REST_S

    def judged(self, verdict: Verdict | None) -> None:
        """Take the verdict on an increment; None if it was lost."""
        if verdict is not None and verdict.outcome is not Outcome.ADMITTED:
            self._limited_by = verdict.reasons

    def lose(self, why: str) -> None:
        """End the present and the waiting trajectories, because the robot is lost; `why` goes to the log."""
        if self.has_work:
            self._driven = self._waiting = None
            self.counters["ended_lost"] += 1
            self._tell(f"the trajectory has ended: {why}", event="ended", ending="lost", why=why)

    def _begin(self, trajectory: Trajectory, q_cmd: Array) -> None:
        self._waiting, self._limited_by, self._resting_cycles = None, (), 0
        try:
            self._driven = TrajectoryFollower(trajectory, q_cmd, self._robot, self._cycle_s)
        except RefusedMessageError as error:
            self._refuse(error)

    def _end(self, ending: TrajectoryEnding) -> None:
        self._driven = None
        if ending in (TrajectoryEnding.BLOCKED, TrajectoryEnding.OFF_PATH):
            self._waiting = None
        self.counters[f"ended_{ending}"] += 1
        self._tell(f"the trajectory has ended: {self._why(ending)}", event="ended", ending=str(ending))

    def _why(self, ending: TrajectoryEnding) -> str:
        match ending:
            case TrajectoryEnding.ARRIVED:
                return "the robot has arrived"
            case TrajectoryEnding.STOPPED:
                return "the robot has come to rest on its path"
            case TrajectoryEnding.OFF_PATH:
                return "the robot has left its path"
            case TrajectoryEnding.BLOCKED:
                reasons = ", ".join(f"{reason.code} {reason.what}".strip() for reason in self._limited_by)
                return f"no progress was made for {BLOCKED_S:g} s; the gate last said {reasons or 'nothing'}"

    def _refuse(self, error: RefusedMessageError) -> None:
        self.counters["refused"] += 1
        self.counters[f"refused_{error.why}"] += 1
        self._tell(f"a trajectory was refused: {error}", event="refused", why=error.why, field=error.field)

    def _tell(self, text: str, **fields: object) -> None:
        self._say(f"{self._name}: {text}", {"robot": self._name, **fields})
