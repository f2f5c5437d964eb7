"""Prediction of another robot's setpoints, by extrapolation.

A setpoint is exact, and the drives reach it some time later. If the drives of both robots lag alike, the camera
looks at the other robot whenever its setpoints look at the other's setpoints. So only the time from the newest known
setpoint to the requested one has to be predicted. If the other robot's drives lag more, a past setpoint is needed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import ServoLag
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.spheres import PlacedSpheres
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Sight

# The other robots of a cell together.


class OtherRobots:
    """Setpoints of every robot but the own one; vectors over the cell are in the cell's order.

    Args:
        cell: the cell.
        robot: name of the own one.
    """

    def __init__(self, cell: CellModel, robot: str) -> None:
        self._robots, self._own = cell.robots, robot
        own, cycle_s = cell.robots[robot], cell.description.cycle_s
        self._others = {
            name: Foreseen(robot, own, cycle_s) for name, robot in self._robots.items() if name != self._own
        }
        self._bodies = {name: PlacedSpheres(self._robots[name]) for name in self._others}

    def update(self, view: View) -> None:
        """Add a view of the cell."""
        for name, other in view.others.items():
            if name in self._others:
                self._others[name].update(view.own, other)

    def named(self, name: str) -> Foreseen:
        """The prediction of one robot."""
        return self._others[name]

    def ahead(self, time_s: float = 0.0) -> dict[str, Array]:
        """(m,) setpoint of each robot with a state, a given time after the own robot's next increment [rad or m]."""
        return {name: other.ahead(time_s) for name, other in self._others.items() if other.setpoints.started}

    def spheres_ahead(self, time_s: float) -> tuple[Array, Array]:
        """Centres (k, 3), radii (k,) of others' bounding spheres `time_s` after the next increment [m]."""
        expected = self.ahead(time_s)
        centres = [self._bodies[name].at(joints) for name, joints in expected.items()]
        return np.concatenate(centres), np.concatenate([self._bodies[name].radii for name in expected])

    def joined(self, q: Array, others: Mapping[str, Array]) -> Array:
        """(m,) joints of all robots of the cell, the own at `q` (n,); a robot without a state counts as at home."""
        return np.concatenate(
            [q if name == self._own else others.get(name, robot.home) for name, robot in self._robots.items()]
        )

    def rates(self) -> Array:
        """(m,) rates of all joints of the cell, the own ones zero [rad/s or m/s]."""
        return np.concatenate(
            [
                self._others[name].velocity
                if name in self._others and self._others[name].setpoints.started
                else np.zeros(robot.n)
                for name, robot in self._robots.items()
            ]
        )


STALE_S = 0.1
"""Age of a view beyond the link's usual delay, above which it is stale: its last predicted setpoint is kept."""
LOST_S = 1.0
"""The same, above which the other robot is lost."""
_USUAL_RISES, _MOST_USUAL_S = 0.01, 0.5
"""Rate at which the link's usual delay, the least of late, may rise [s/s], and how long it is at most [s]."""
_ACCELERATION_S = 0.03
"""Time for which an unobserved acceleration is assumed to last."""
_STEADY_S, _VELOCITY_S = 0.15, 0.3
"""Times for which an unobserved velocity is assumed to stay, and then to decay."""
_PAST_S = 0.3
"""Time for which setpoints are kept; no supported drive lags longer."""


@dataclass(frozen=True)
class _Known:
    cycle: int
    q_cmd: Array


class SetpointTracker:
    """Setpoints of one robot, their velocity and acceleration.

    Args:
        cycle_s: cycle of the robot [s]; setpoints are distinguished by cycles, since stamps of their arrival jitter.

    Attributes:
        velocity: (n,) of the newest setpoint, or of the last that is planned [rad/s or m/s]; empty before the first.
    """

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._known: _Known | None = None
        self._past: deque[_Known] = deque(maxlen=math.ceil(_PAST_S / cycle_s) + 1)  # newest first
        self._planned: list[_Known] = []  # last first
        self._mean_velocity: Array | None = None
        self.velocity: Array = np.zeros(0)
        self._acceleration: Array = np.zeros(0)

    @property
    def started(self) -> bool:
        """Whether a setpoint is known."""
        return self._known is not None

    def update(self, view: RobotView) -> None:
        """Add a view of the robot; a repeated cycle changes nothing."""
        known, q_cmd = self._known, np.array(view.q_cmd, dtype=np.float64)
        elapsed_s = 0.0 if known is None else (view.cycle - known.cycle) * self._cycle_s
        if known is not None and elapsed_s == 0.0:
            return
        self._known = _Known(view.cycle, q_cmd)
        self._past.appendleft(self._known)
        self._planned = []
        if known is None or not 0.0 < elapsed_s < LOST_S:
            self._past = deque([self._known], self._past.maxlen)
            self.velocity, self._acceleration = np.zeros_like(q_cmd), np.zeros_like(q_cmd)
            self._mean_velocity = None
            return
        mean = (q_cmd - known.q_cmd) / elapsed_s
        before = mean if self._mean_velocity is None else self._mean_velocity
        self._acceleration = (mean - before) / elapsed_s
        self._mean_velocity = mean
        for cycle, dq in enumerate(view.planned, view.cycle + 1):
            q_cmd, before, mean = q_cmd + dq, mean, dq / self._cycle_s
            self._acceleration = (mean - before) / self._cycle_s
            self._planned.insert(0, _Known(cycle, q_cmd))
        self.velocity = mean + 0.5 * self._cycle_s * self._acceleration

    @property
    def planned_s(self) -> float:
        """Time from the newest setpoint to the last that is planned [s]."""
        return len(self._planned) * self._cycle_s

    def ahead(self, time_s: float) -> Array:
        """(n,) predicted setpoint `time_s` after the newest known one; a past one if negative [rad or m].

        Planned setpoints come first. The farther beyond them, the less of the acceleration counts, and then of the
        velocity.
        """
        if self._known is None:
            raise ControllerError("no setpoint is known yet: call update() first")
        time_s -= self.planned_s
        last = self._planned[0] if self._planned else self._known
        if time_s < 0.0:
            return self._before(last.cycle + time_s / self._cycle_s)
        moves_s = min(time_s, _STEADY_S) + _faded(max(time_s - _STEADY_S, 0.0), _VELOCITY_S)
        gains_s2 = _ACCELERATION_S * (moves_s - _faded(moves_s, _ACCELERATION_S))
        expected: Array = last.q_cmd + moves_s * self.velocity + gains_s2 * self._acceleration
        return expected

    def _before(self, cycle: float) -> Array:
        """(n,) setpoint of a cycle, planned or past, or between two; the oldest that is kept for earlier ones."""
        known = [*self._planned, *self._past]
        later = known[0]
        for earlier in known:
            if earlier.cycle <= cycle:
                share = (cycle - earlier.cycle) / max(later.cycle - earlier.cycle, 1)
                between: Array = earlier.q_cmd + share * (later.q_cmd - earlier.q_cmd)
                return between
            later = earlier
        return later.q_cmd


class Foreseen:
    """Predicts another robot's setpoint at the time when the own robot's next increment takes effect.

    Both views are stamped on one clock, wherever their Robot Servers are (`deltaq_controllers.robot_clocks`).

    Args:
        other: the robot that is watched.
        own: the robot that an increment is for.
        cycle_s: cycle of both [s].

    Attributes:
        setpoints: the known setpoints.
        age_s: age of the other robot's state relative to the own one [s].
    """

    def __init__(self, other: RobotModel, own: RobotModel, cycle_s: float) -> None:
        self.setpoints = SetpointTracker(cycle_s)
        self._cycle_s, self._max_dq = cycle_s, other.max_velocity * cycle_s
        self._later_s = lag_s(own.description.servo_lag) - lag_s(other.description.servo_lag)
        self._ahead_s = self.age_s = self._late_s = 0.0
        self._usual_s = _MOST_USUAL_S

    @property
    def sight(self) -> Sight:
        """How well the other robot is seen; lost before it was ever seen."""
        if not self.setpoints.started or self._late_s > LOST_S:
            return Sight.LOST
        return Sight.STALE if self._late_s > STALE_S else Sight.FRESH

    @property
    def velocity(self) -> Array:
        """(n,) of the other robot's setpoint when the increment takes effect [rad/s or m/s]."""
        if self._late_s > STALE_S:
            return np.zeros_like(self.setpoints.velocity)
        beyond_s = self._ahead_s - self.setpoints.planned_s
        if beyond_s < 0.0:
            passed: Array = (self.ahead() - self.ahead(-self._cycle_s)) / self._cycle_s
            return passed
        return math.exp(-max(beyond_s - _STEADY_S, 0.0) / _VELOCITY_S) * self.setpoints.velocity

    def update(self, own: RobotView, other: RobotView) -> None:
        """Add a view of the cell."""
        if other.planned:  # its controller may ask for anything; the gate admits no more than this
            planned = tuple(dq.clip(-self._max_dq, self._max_dq) for dq in other.planned)
            other = replace(other, planned=planned)
        self.setpoints.update(other)
        self.age_s = own.time_s - other.time_s
        self._usual_s = min(self.age_s, self._usual_s + _USUAL_RISES * self._cycle_s, _MOST_USUAL_S)
        self._late_s = self.age_s - self._usual_s
        expected_s = self._usual_s + min(self._late_s, STALE_S)
        self._ahead_s = expected_s + (own.ahead_cycles + 1) * self._cycle_s + self._later_s

    def ahead(self, time_s: float = 0.0) -> Array:
        """(n,) setpoint of the other robot `time_s` after the own increment takes effect [rad or m]."""
        return self.setpoints.ahead(self._ahead_s + time_s)


def lag_s(lag: ServoLag) -> float:
    """Lag of drives behind a setpoint of constant speed [s]."""
    return lag.dead_time_s + 2.0 * lag.damping / lag.natural_frequency_rad_s


def _faded(time_s: float, constant_s: float) -> float:
    """For how long a rate that decays would have to last to come as far as in `time_s`."""
    return constant_s * (1.0 - math.exp(-time_s / constant_s))
