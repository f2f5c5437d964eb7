"""What an experiment adds to a camera controller: a start configuration, and a sequence of view distances.

Time is the stamp of the states, so that the same views give the same increments, live and in virtual time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deltaq_controllers.camera.controllers import FocusController
from deltaq_controllers.interface import ControllerError, LastIncrement, RobotView, View
from deltaq_controllers.limits import IncrementLimits
from deltaq_protocol.arrays import Array

SPEED_SHARE, BRAKE_SHARE = 0.2, 0.3
"""Fractions of the joints' speeds and accelerations that the motion to the start uses."""

ARRIVED = 1e-4
"""Largest distance of a joint's setpoint from the start, and largest motion of setpoint and joint in a cycle, at which
the start counts as reached [rad or m]."""


class MoveToStart:
    """Brings the robot to its start, and then lets the camera controller go on.

    Args:
        camera: the controller.
        limits: of the robot's increments.
        start: (n,) where to begin; None for where the robot stands [rad or m].
        distances_m: view distances that the operator selects, one after the other; none leaves it unchanged [m].
        hold_s: time that each is kept; the last is kept for ever [s].

    Attributes:
        began_s: stamp of the state with which the camera controller began; None before [s].
    """

    def __init__(
        self,
        camera: FocusController,
        limits: IncrementLimits,
        start: Array | None = None,
        distances_m: Sequence[float] = (),
        hold_s: float = 8.0,
    ) -> None:
        if start is not None and start.shape != limits.max_dq.shape:
            raise ControllerError(
                f"start: the robot has {len(limits.max_dq)} joints, got {start.size} values"
            )
        self.began_s: float | None = None
        self._camera, self._limits = camera, limits
        self._start, self._distances_m, self._hold_s = start, tuple(distances_m), hold_s
        self._last = LastIncrement(limits.max_ddq)
        self._last_q: Array | None = None

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        dq_last = self._last.update(view.own)
        if self.began_s is None:
            if not self._arrived(view.own, dq_last):
                return self._limits.admissible(self._onward(view.own.q_cmd), view.own.q_cmd, dq_last)
            self.began_s = view.own.time_s
        if self._distances_m:
            turns = int((view.own.time_s - self.began_s) / self._hold_s)
            self._camera.desired_distance_m = self._distances_m[min(turns, len(self._distances_m) - 1)]
        return self._camera.increment(view)

    def _arrived(self, own: RobotView, dq_last: Array) -> bool:
        if self._start is None:
            return True
        # the robot itself follows its setpoint some cycles behind, and is still under way when the setpoint rests
        moved = np.inf if self._last_q is None else np.abs(own.q - self._last_q).max()
        self._last_q = own.q
        return bool(max(np.abs(self._start - own.q_cmd).max(), np.abs(dq_last).max(), moved) < ARRIVED)

    def _onward(self, q_cmd: Array) -> Array:
        """A step along the straight line to the start from which all joints can still stop there."""
        assert self._start is not None  # else the robot has arrived
        way = self._start - q_cmd
        far = np.maximum(np.abs(way), 1e-12)
        speed = SPEED_SHARE * self._limits.max_dq / far
        brake = np.sqrt(2.0 * BRAKE_SHARE * self._limits.max_ddq / far)
        share = min(float(speed.min()), float(brake.min()), 1.0)
        return share * way
