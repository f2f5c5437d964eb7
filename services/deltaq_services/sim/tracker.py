"""The gate's knowledge of one robot: its newest state, the setpoints before it, and its possible courses.

Until a state shows which admission the Robot Server follows, the old brake and the admission in flight are
both courses that the robot may take.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_increment
from deltaq_protocol.guarded import Admission, ServerState, TrackerMemory
from deltaq_services.sim.tube import Branch, Windows, tube

_ENDED_PROCESSES = 16
"""Processes of one Robot Server that are remembered: their states may be overtaken by those of their successor."""

_SUMS = 1e-9
"""Rounding of a setpoint when increments are added in another order [rad or m]."""

_ROUNDING = 2e-5
"""Rounding of a measured joint by a telegram's decimals [rad or m]."""


class Tracker:
    """Follows one robot by its states and the admissions sent to it.

    Attributes:
        units: unit of each joint.
        state: the newest state; None before the first.
        in_flight: an admission that no state has confirmed or outdated yet.
        missed: admissions that the Robot Server did not take.
        restarted: whether the newest state is the first of another Robot Server process.
        displaced: whether its setpoint is not where the increments since the last state can have brought it.
    """

    def __init__(self, name: str, description: RobotDescription, cycle_s: float, lag_cycles: int) -> None:
        self.name = name
        self.state: ServerState | None = None
        self.in_flight: Admission | None = None
        self.missed = 0
        self.restarted = self.displaced = False
        self._fastest = description.max_velocity * cycle_s
        self._lag = max(2, lag_cycles)
        self.units = description.units
        self._tolerance = description.tracking_tolerance
        self._history: deque[Array] = deque(maxlen=self._lag)
        self._ended: deque[int] = deque(maxlen=_ENDED_PROCESSES)

    def observe(self, state: ServerState) -> bool:
        """Take a state; returns False if no cycle of the robot has passed since the last."""
        self.restarted = self.displaced = False
        if state.process in self._ended:
            return False
        if self.state is not None and state.process != self.state.process:
            self.restarted = True
            self._ended.append(self.state.process)
            self._history.clear()
            self.in_flight = None
        elif self.state is not None:
            if state.cycle == self.state.cycle and state.time_s >= self.state.time_s:
                self.state = state  # the KRC is silent, but phase and reason may have changed
            if state.cycle <= self.state.cycle:
                return False
            self.displaced = self._is_displaced(self.state, state)
        self.state = state
        if self.in_flight is not None:
            if (state.epoch, state.sequence) != (self.in_flight.epoch, self.in_flight.sequence):
                self.missed += 1
            self.in_flight = None
        # in a new session the drives are held where the KRC says, and a reset continues from there
        self._history.append(np.array(state.q_cmd if state.q_reset is None else state.q_reset))
        return True

    def _is_displaced(self, before: ServerState, state: ServerState) -> bool:
        travel = np.array(state.q_cmd) - np.array(before.q_cmd)
        # the increment is that of the last cycle, also where the KRC missed the reply and stands where it stood
        unexplained = np.abs(travel - np.array(state.dq))
        unseen = state.cycle - before.cycle - 1
        return bool(travel.any() and np.any(unexplained > unseen * self._fastest * (1 + 1e-6) + _SUMS))

    def snapshot(self) -> TrackerMemory:
        """Snapshot for `restore`."""
        history = tuple(tuple(setpoint.tolist()) for setpoint in self._history)
        return TrackerMemory(
            state=self.state,
            ended_processes=tuple(self._ended),
            in_flight=self.in_flight,
            missed=self.missed,
            history=history,
        )

    def restore(self, memory: TrackerMemory) -> None:
        """Restore a snapshot of another tracker of this robot."""
        self.state, self.in_flight, self.missed = memory.state, memory.in_flight, memory.missed
        self._history.clear()
        self._history.extend(np.array(setpoint) for setpoint in memory.history)
        self._ended.clear()
        self._ended.extend(memory.ended_processes)

    @property
    def q_cmd(self) -> Array:
        """(n,) present setpoint [rad or m]."""
        return self._history[-1]

    def brake(self) -> Array:
        """(n,) next increment of the brake that the Robot Server sends without a new admission."""
        branch = self._planned()
        return brake_increment(branch.dq, branch.brake_cycles, branch.step + 1)

    def _planned(self) -> Branch:
        assert self.state is not None  # asked only of robots that have been heard
        plan = self.state.plan
        return Branch(np.array(plan.dq), plan.brake_cycles, plan.step)

    def tube(self, branch: Branch) -> Windows:
        """The tube of one course from the present setpoint."""
        assert self.state is not None  # asked only of robots that have been heard
        history, q = np.array(self._history), np.array(self.state.q)
        beyond = np.maximum(history.min(axis=0) - q, q - history.max(axis=0))
        return tube(history, branch, self._lag, q if np.any(beyond > _ROUNDING) else None)

    def tube_of_setpoints(self, branch: Branch) -> Windows:
        """The same, wherever the robot is measured to be."""
        return tube(np.array(self._history), branch, self._lag)

    def tubes(self) -> list[Windows]:
        """The tubes of every course that the robot may take."""
        return [self.tube(branch) for branch in self._courses()]

    def tubes_of_setpoints(self) -> list[Windows]:
        """The same, wherever the robot is measured to be."""
        return [self.tube_of_setpoints(branch) for branch in self._courses()]

    def _courses(self) -> list[Branch]:
        courses = [self._planned()]
        if self.in_flight is not None:
            courses.append(Branch(np.array(self.in_flight.dq), self.in_flight.brake_cycles, -1))
        return courses

    def standing(self) -> Windows:
        """The tube of a robot that is sent nothing more: where the drives may be now."""
        return self.tube(Branch(np.zeros_like(self.q_cmd), 1, 0))

    def at_rest(self) -> bool:
        """Whether nothing is left to send and the drives have caught up."""
        settled = all((setpoint == self.q_cmd).all() for setpoint in self._history)
        return settled and len(self._history) == self._lag and not self._planned().setpoints(self.q_cmd).size

    def stands_still(self) -> bool:
        """Whether it is at rest, and nothing is in flight that could set it in motion."""
        return self.in_flight is None and self.at_rest()

    def off_path(self) -> tuple[int, float, float] | None:
        """The joint that left the commanded path by more than its tolerance: index, distance, tolerance."""
        assert self.state is not None  # asked only of robots that have been heard
        history = np.array(self._history)
        q = np.array(self.state.q)
        distance = np.maximum(history.min(axis=0) - q, q - history.max(axis=0))
        joint = int(np.argmax(distance / self._tolerance))
        if distance[joint] <= self._tolerance[joint]:
            return None
        return joint, float(distance[joint]), float(self._tolerance[joint])
