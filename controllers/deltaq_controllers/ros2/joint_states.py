"""A robot's states as ROS messages."""

from __future__ import annotations

from deltaq_controllers.ros2.messages import Header, JointState, RosTime
from deltaq_protocol.messages import RobotState, RobotSummary

_NEAR_CYCLES = 10
"""States farther apart tell no velocity."""


class JointStates:
    """Makes the joint states of one robot.

    Args:
        robot: its joints.
        cycle_s: of the cell.
    """

    def __init__(self, robot: RobotSummary, cycle_s: float) -> None:
        self._joints = robot.joints
        self._cycle_s = cycle_s
        self._before: RobotState | None = None

    def message(self, state: RobotState, now_ns: int) -> JointState:
        """The measured positions and, from those of the state before, velocities; there is no effort.

        Args:
            state: newer than the one before.
            now_ns: time since the epoch [ns]. It is the stamp; the state's own is on the clock of the robot's server.
        """
        before, self._before = self._before, state
        velocity: tuple[float, ...] = ()
        if before is not None and 0 < state.cycle - before.cycle <= _NEAR_CYCLES:
            between_s = (state.cycle - before.cycle) * self._cycle_s
            velocity = tuple(
                (q - q_before) / between_s for q, q_before in zip(state.q, before.q, strict=True)
            )
        return JointState(Header(RosTime.of_ns(now_ns)), self._joints, state.q, velocity)
