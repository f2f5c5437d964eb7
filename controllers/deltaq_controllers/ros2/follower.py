"""Follow a path from cycle to cycle: what is asked for is on it, and where less is admitted its time stretches."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from deltaq_controllers.interface import LastIncrement, RobotView, View
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.ros2.path import Path
from deltaq_controllers.ros2.profile import Profile
from deltaq_controllers.ros2.trajectory import START_WITHIN, Trajectory, path_from
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import RobotSummary

BLOCKED_S = 2.0
"""A robot that has made no way along its path for so long is not waited for [s]."""

_STEPS = 8
_BISECTIONS = 6
_TAKEN_BACK_CYCLES = 20.0
"""Cycles in which a deviation is corrected: a brake of the gate is straight, a path may bend."""
_SEARCHED_S = 0.5
"""How far from where it was last the robot is looked for, back and ahead, by the path's time [s]."""
_SEARCHED = 257
_PROGRESS_S = 1e-4
"""Way along the path that counts as some [s of its time]."""
_ARRIVED = 1e-6
"""Share of a joint's greatest increment by which it may miss the end."""


class Ending(StrEnum):
    """How a trajectory ended."""

    ARRIVED = "arrived"
    STOPPED = "stopped"
    BLOCKED = "blocked"
    OFF_PATH = "off_path"


class TrajectoryFollower:
    """Makes the increments of one trajectory, which begins where the robot rests.

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
        self.ending: Ending | None = None
        self.path: Path = path_from(trajectory, q_cmd, robot)
        self._limits = IncrementLimits.told(robot, cycle_s)
        self._profile = Profile(self.path, self._limits, cycle_s)
        self._last = LastIncrement(self._limits.max_ddq)
        self._within = np.array([START_WITHIN[unit] for unit in robot.units])
        self._cycle_s = cycle_s
        self._at_s = self._sent_to_s = self._farthest_s = 0.0
        self._idle_cycles = 0
        self._stops = False

    @property
    def done(self) -> float:
        """Share of the path's time that lies behind the robot, 0 to 1."""
        return self._at_s / self.path.duration_s

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
        left_s = self.path.duration_s - self._at_s
        steps_s = np.linspace(0.0, min(self._cycle_s, left_s), _STEPS + 1)
        back = here + deviation / _TAKEN_BACK_CYCLES
        excess = self._excess(steps_s, back, dq_last)
        allowed = np.flatnonzero(excess <= 1.0)
        if not len(allowed):  # so fast, or so far away, that no step is: the nearest to what is
            self._sent_to_s = self._at_s + float(steps_s[excess.argmin()])
            return self._to(self._sent_to_s) - back
        wanted, beyond = (allowed[0], allowed[0] - 1) if self._stops else (allowed[-1], allowed[-1] + 1)
        step_s = float(steps_s[wanted])
        if 0 <= beyond <= _STEPS:
            other_s = float(steps_s[beyond])
            for _ in range(_BISECTIONS):
                middle_s = 0.5 * (step_s + other_s)
                if self._excess(np.array([middle_s]), back, dq_last)[0] <= 1.0:
                    step_s = middle_s
                else:
                    other_s = middle_s
        self._sent_to_s = self._at_s + step_s
        return self._to(self._sent_to_s) - back

    def _excess(self, steps_s: Array, back: Array, dq_last: Array) -> Array:
        """(k,) 1 or less: that step along the path is within all limits; while it comes to rest, of the joints only."""
        dq = self._ahead(steps_s) - back
        joints = np.maximum(
            np.abs(dq - dq_last) / self._limits.max_ddq, np.abs(dq) / self._limits.max_dq
        ).max(axis=1)
        if self._stops:
            return np.asarray(joints)
        rate = steps_s / self._cycle_s
        too_fast = rate > self._profile.rate(self._at_s + steps_s)
        # what passes the profile is never chosen for being nearest to the limits, unless all do
        return np.where(too_fast, np.maximum(joints, 1.0) + rate, joints)

    def _to(self, time_s: float) -> Array:
        place: Array = self.path.at(np.array([time_s]))[0]
        return place

    def _ahead(self, steps_s: Array) -> Array:
        return self.path.at(self._at_s + steps_s)

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
        for _ in range(5):  # each time eight times as fine
            fine_s = np.linspace(lower_s, upper_s, 2 * _STEPS + 1)
            k = int(self._distances(fine_s, q_cmd).argmin())
            lower_s, upper_s = fine_s[max(k - 1, 0)], fine_s[min(k + 1, 2 * _STEPS)]
        self._at_s = float(fine_s[k])
        return self._to(self._at_s)

    def _distances(self, times_s: Array, q_cmd: Array) -> Array:
        away = (self.path.at(times_s) - q_cmd) / self._limits.max_dq
        distances: Array = (away**2).sum(axis=1)
        return distances

    def _ends(self, own: RobotView, deviation: Array, dq_last: Array) -> None:
        """Whether the trajectory has ended: see `Ending`."""
        rests = bool((np.abs(dq_last) <= _ARRIVED * self._limits.max_dq).all())
        on_path = bool((np.abs(deviation) <= _ARRIVED * self._limits.max_dq).all())
        if self._at_s > self._farthest_s + _PROGRESS_S:
            self._farthest_s, self._idle_cycles = self._at_s, 0
        else:
            self._idle_cycles += 1
        if (np.abs(deviation) > self._within).any():
            self.ending = Ending.OFF_PATH
        elif rests and on_path and self._at_s >= self.path.duration_s:
            self.ending = Ending.ARRIVED
        elif rests and self._stops:
            self.ending = Ending.STOPPED
        elif self._idle_cycles * self._cycle_s > BLOCKED_S:
            self.ending = Ending.BLOCKED
