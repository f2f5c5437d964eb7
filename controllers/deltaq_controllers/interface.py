"""The interface of controllers: one method, from a view of the cell to one increment.

A cell in virtual time and a running cell accept any object with this method.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import RobotState


class ControllerError(DeltaqError):
    """A controller cannot do what was requested."""


@dataclass(frozen=True)
class RobotView:
    """One robot as a controller sees it.

    Attributes:
        cycle: whose setpoint `q_cmd` is, the robot's newest or with a lookahead a later one.
        time_s: stamp of the state on the clock of the server of the robot that is moved [s].
        q: (n,) measured configuration [rad or m].
        q_cmd: (n,) setpoint that an increment is added to: the one just sent, or with a lookahead the last of
            those that are admitted already [rad or m].
        dq: (n,) increment that leads to `q_cmd`, where the robot is too far away to see it [rad or m].
        ahead_cycles: by how many cycles `cycle` is later than the state: an increment takes effect so much later.
        planned: increments of the next cycles, each (n,), as far as they wait in the robot's jitter buffer [rad or m].
    """

    cycle: int
    time_s: float
    q: Array
    q_cmd: Array
    ahead_cycles: int = 0
    dq: Array | None = None
    planned: tuple[Array, ...] = ()

    @classmethod
    def from_state(cls, state: RobotState) -> Self:
        """Make it from a state message."""
        q_cmd = state.q_cmd if state.q_ahead is None else state.q_ahead
        cycle = state.cycle if state.setpoint_cycle is None else state.setpoint_cycle - 1
        planned = () if state.playout is None else tuple(map(np.array, state.playout.planned))
        ahead_cycles = cycle - state.cycle
        return cls(cycle, state.time_s, np.array(state.q), np.array(q_cmd), ahead_cycles, planned=planned)

    def after(self, cycle: int, dq: Array) -> RobotView:
        """The view with an increment (n,) in flight added; the increment takes effect in the cycle after `cycle`.

        A controller that left it out would request its motion twice.
        """
        return RobotView(cycle + 1, self.time_s, self.q, self.q_cmd + dq, self.ahead_cycles)


@dataclass(frozen=True)
class View:
    """The input of a controller in one cycle.

    Attributes:
        own: the robot that the controller moves.
        others: the newest state of each other robot of the cell, by name.
    """

    own: RobotView
    others: Mapping[str, RobotView] = field(default_factory=dict)


class Controller(Protocol):
    """Anything that answers each view with one increment."""

    def increment(self, view: View) -> Array:
        """The increment for this cycle.

        Args:
            view: states of the robot and of the others.

        Returns:
            (n,) joint increment over one cycle [rad or m].
        """
        ...


_RECKONED_CYCLES = 10
"""A setpoint that was reckoned with and did not come is at most so far ahead; another Robot Server counts from one."""


class LastIncrement:
    """The last command of a robot, read from its setpoints.

    Verdicts contain the same, but they can get lost; a setpoint cannot. In a cycle that the controller missed the
    robot braked, so in a gap the first increment is taken as admitted and the others as its brake.

    Args:
        max_ddq: (n,) largest change of the increment between two cycles, which the brake uses [rad or m].
    """

    def __init__(self, max_ddq: Array) -> None:
        self._max_ddq = max_ddq
        self._cycle = -1
        self._q_cmd: Array | None = None
        self._dq: Array = np.zeros_like(max_ddq)

    def update(self, view: RobotView) -> Array:
        """The (n,) increment that led to this setpoint; zero for the first one [rad or m]."""
        cycles = view.cycle - self._cycle
        if view.dq is not None:
            self._dq = view.dq
        elif self._q_cmd is None or cycles < -_RECKONED_CYCLES:
            self._dq = np.zeros_like(self._max_ddq)
        elif cycles > 0:
            self._dq = self._last_of(view.q_cmd - self._q_cmd, cycles)
        # where no cycle has passed something in flight was lost or clipped: the last increment is the same
        self._cycle, self._q_cmd = view.cycle, view.q_cmd
        return self._dq

    def _last_of(self, moved: Array, cycles: int) -> Array:
        if cycles == 1:
            return moved
        # moved = first * (1 + (N - 1) / N + ... ) for the least N that can brake first; the mean is less than first
        brake = brake_cycles(moved / cycles, self._max_ddq)
        while True:
            steps = min(cycles, brake)
            first = moved / (steps - steps * (steps - 1) / (2 * brake))
            if brake_cycles(first, self._max_ddq) <= brake:
                return brake_increment(first, brake, cycles - 1)
            brake += 1


# Adds latency to a controller's view of other robots, for experiments.


class HeldBack:
    """Delays a controller's view of the other robots, with their stamps; its own robot is not delayed.

    Args:
        controller: makes the increments.
        cycles: by how many views the others are held back.
    """

    def __init__(self, controller: Controller, cycles: int) -> None:
        self._controller = controller
        self._seen: deque[Mapping[str, RobotView]] = deque(maxlen=cycles + 1)

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        self._seen.append(view.others)
        return self._controller.increment(View(view.own, self._seen[0]))
