"""The trajectories that ROS requests of a robot: one is driven at a time, and the newest goes first.

Pure: messages, states and verdicts are handed in, with the time where it matters.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from deltaq_controllers.interface import View
from deltaq_controllers.ros2.follower import BLOCKED_S, TrajectoryEnding, TrajectoryFollower
from deltaq_controllers.ros2.messages import JointTrajectory
from deltaq_controllers.ros2.refusal import RefusedMessageError
from deltaq_controllers.ros2.rmw import RosAttachment
from deltaq_controllers.ros2.trajectory import Trajectory, read_trajectory
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome, Phase, Reason, RobotState, RobotSummary, Verdict

TrajectoryNews = Callable[[str, Mapping[str, Any]], None]
"""Tells people, and with fields programs, what has happened."""

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

    @property
    def done(self) -> float | None:
        """Share of the time of the trajectory that is driven, 0 to 1; None if there is none."""
        return None if self._driven is None else self._driven.done

    def hear(self, message: bytes, attachment: bytes | None, now_ns: int) -> None:
        """A message has come, from anybody; now is in ns since the epoch."""
        try:
            RosAttachment.decode(attachment)
            trajectory = read_trajectory(JointTrajectory.decode(message), self._robot, now_ns)
        except RefusedMessageError as error:
            self._refuse(error)
            return
        if trajectory is None:
            self.counters["stops"] += 1
            self._tell("an empty trajectory came: the robot is to rest", event="stop")
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
        """Whether nothing is in flight any more: whoever gave the lease back before would take it back, too."""
        self._resting_cycles += 1
        in_flight = np.abs(view.own.q_cmd - np.array(state.q_cmd)).max()
        return bool(in_flight <= _NOTHING) or self._resting_cycles * self._cycle_s > _LONGEST_REST_S

    def judged(self, verdict: Verdict | None) -> None:
        """A verdict has come on an increment, or None never will."""
        if verdict is not None and verdict.outcome is not Outcome.ADMITTED:
            self._limited_by = verdict.reasons

    def lose(self, why: str) -> None:
        """The robot cannot be moved any more: the present and waiting trajectories have ended; `why` is for people."""
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
                return f"no way was made for {BLOCKED_S:g} s; the gate last said {reasons or 'nothing'}"

    def _refuse(self, error: RefusedMessageError) -> None:
        self.counters["refused"] += 1
        self.counters[f"refused_{error.why}"] += 1
        self._tell(f"a trajectory was refused: {error}", event="refused", why=error.why, field=error.field)

    def _tell(self, text: str, **fields: object) -> None:
        self._say(f"{self._name}: {text}", {"robot": self._name, **fields})
