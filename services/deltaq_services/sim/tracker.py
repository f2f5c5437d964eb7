"""The gate's knowledge of one robot: its newest state, the setpoints before it, and its possible courses.

Until a state shows which admission the Robot Server follows, the robot may take the old brake or any admission in
flight (`courses` in `deltaq_services.sim.tube`). The next decision continues from the end of the last one.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_cell.kernel.span import off_hull, widths
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, ServerState, TrackerMemory
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.sim.tube import Branch, DriveBounds, Windows, courses, motions, still_due, tube, up_to


class History:
    """The setpoints that still affect the drives of one robot, oldest first, one for each known cycle.

    A setpoint leaves the history when as many cycles have passed as the drives lag. Two kinds of setpoints do not count
    as a cycle, so that older ones stay longer: one that was sent again because the KRC missed it, and those that the
    robot may have been sent in cycles of which no state came.

    Args:
        lag: how many setpoints back the drives may be.
    """

    def __init__(self, lag: int) -> None:
        self._lag = lag
        self._setpoints: deque[Array] = deque()
        self._passed: deque[bool] = deque()
        self._cycles = 0
        self._array: Array | None = None

    def sent(self, setpoint: Array, passed: bool = True) -> None:
        """A setpoint (n,) was sent, or may have been [rad or m]; `passed` if a cycle of the drives went by with it."""
        self._setpoints.append(setpoint)
        self._passed.append(passed)
        self._cycles += passed
        self._array = None
        while self._cycles > self._lag + 1 or (self._passed and not self._passed[0] and self.is_full):
            self._setpoints.popleft()
            self._cycles -= self._passed.popleft()

    def may_have_been_sent(self, setpoints: Iterable[Array]) -> None:
        """Some of these setpoints, each (n,), may have been sent [rad or m]."""
        for setpoint in setpoints:
            self.sent(setpoint, passed=False)

    @property
    def newest(self) -> Array:
        """(n,) present setpoint [rad or m]."""
        return self._setpoints[-1]

    @property
    def is_full(self) -> bool:
        """Whether it has every setpoint that the drives may be at."""
        return self._cycles > self._lag

    @property
    def rests(self) -> bool:
        """Whether the setpoint has rested for as long as the drives lag."""
        return self.is_full and all((setpoint == self.newest).all() for setpoint in self._setpoints)

    def array(self) -> Array:
        """(k, n) all of them [rad or m]."""
        if self._array is None:
            self._array = np.array(self._setpoints)
        return self._array

    def snapshot(self) -> tuple[tuple[tuple[float, ...], ...], tuple[bool, ...]]:
        """The setpoints, and with which of them a cycle passed."""
        return tuple(tuple(setpoint.tolist()) for setpoint in self._setpoints), tuple(self._passed)

    def restore(self, setpoints: Sequence[Sequence[float]], passed: Sequence[bool]) -> None:
        """Restore a snapshot. One of an earlier version lacks `passed`: then a cycle passed with every setpoint."""
        self._setpoints = deque(np.array(setpoint) for setpoint in setpoints)
        self._passed = deque(passed or [True] * len(setpoints))
        self._cycles = sum(self._passed)
        self._array = None


_ENDED_PROCESSES = 16
"""Processes of one Robot Server that are remembered: their states may be overtaken by those of their successor."""

_SUMS = 1e-9
"""Rounding of a setpoint when increments are added in another order [rad or m]."""


class Tracker:
    """Follows one robot by its states and the admissions sent to it.

    Attributes:
        drives: how the robot follows its setpoints.
        units: unit of each joint.
        state: the newest state; None before the first.
        in_flight: admissions that no state has confirmed or outdated yet, each following the one before it.
        missed: admissions that the Robot Server did not take.
        restarted: whether the newest state is the first of another Robot Server process.
        history: the setpoints that its drives may still be at.
        displaced: whether its setpoint is not where the increments since the last state can have brought it.
    """

    def __init__(
        self,
        name: str,
        description: RobotDescription,
        drives: DriveBounds,
        cycle_s: float,
        lookahead_cycles: int = 1,
    ) -> None:
        self.name, self.drives = name, drives
        self.state: ServerState | None = None
        self.in_flight: tuple[Admission, ...] = ()
        self._ahead: list[SetpointMotion] | None = None
        self._known_courses: list[Branch] | None = None
        self._decided_after: int | None = None
        self._lookahead_cycles = lookahead_cycles
        self.missed = 0
        self.restarted = self.displaced = False
        self._fastest = description.max_velocity * cycle_s
        self.units = description.units
        self._limits = np.maximum(np.abs(description.lower), np.abs(description.upper))
        self.history = History(self.drives.lag)
        self._ended: deque[int] = deque(maxlen=_ENDED_PROCESSES)
        self._off: tuple[int, float, float] | None = None
        self._present: SetpointMotion | None = None

    def observe(self, state: ServerState) -> bool:
        """Take a state; returns False if no cycle of the robot has passed since the last."""
        self.restarted = self.displaced = False
        self._off = None
        if state.process in self._ended:
            return False
        if self.state is not None and state.process != self.state.process:
            self.restarted = True
            self._ended.append(self.state.process)
            # the robot has been braked along one of its courses, and the drives may be anywhere on it
            self.history.may_have_been_sent(self._possible())
            self._fly(())
        elif self.state is not None:
            if state.cycle == self.state.cycle and state.time_s >= self.state.time_s:
                # the KRC is silent, but phase, reason and plan may have changed
                self.state = state
                self._fly(self.in_flight)
            if state.cycle <= self.state.cycle:
                return False
            self.displaced = self._is_displaced(self.state, state)
            self._pass_unheard(self.state, state)
        missed_reply = self.state is not None and not self.restarted and _stood(self.state, state)
        self.state = state
        still = still_due(state, self.in_flight)
        self.missed += _missed(state, self.in_flight) - len(still)
        self._fly(still)
        # in a new session the drives are held where the KRC says, and a reset continues from there
        setpoint = np.array(state.q_cmd if state.q_reset is None else state.q_reset)
        self.history.sent(setpoint, passed=not missed_reply)
        return True

    def _possible(self) -> list[Array]:
        """Every setpoint, each (n,), that may follow the present one [rad or m]."""
        return [setpoint for branch in self._courses() for setpoint in branch.setpoints(self.q_cmd)]

    def _pass_unheard(self, before: ServerState, state: ServerState) -> None:
        """Remember the setpoints of the cycles between two states, or all that are possible."""
        unheard = state.cycle - before.cycle - 1
        if 0 < unheard <= self.drives.lag:
            chain = up_to(state.sequence, self.in_flight)
            sent = motions(self._now(), before.cycle, chain, unheard + 1)
            if np.array_equal(sent[-1].q_cmd, state.q_cmd):
                for motion in sent[1:-1]:
                    self.history.sent(motion.q_cmd)
                return
        if unheard > 0:
            self.history.may_have_been_sent(self._possible())

    def _is_displaced(self, before: ServerState, state: ServerState) -> bool:
        if state.q_cmd == before.q_cmd:
            return False
        unseen = state.cycle - before.cycle - 1
        # the increment is that of the last cycle, also where the KRC missed the reply and stands where it stood
        told = zip(state.q_cmd, before.q_cmd, state.dq, self._fastest.tolist(), strict=True)
        return any(abs(q - old - dq) > unseen * fastest * (1 + 1e-6) + _SUMS for q, old, dq, fastest in told)

    def snapshot(self) -> TrackerMemory:
        """Snapshot for `restore`."""
        history, passed = self.history.snapshot()
        return TrackerMemory(
            state=self.state,
            ended_processes=tuple(self._ended),
            in_flight=self.in_flight,
            missed=self.missed,
            history=history,
            passed=passed,
        )

    def restore(self, memory: TrackerMemory) -> None:
        """Restore a snapshot of another tracker of this robot."""
        self.state, self.missed = memory.state, memory.missed
        self._fly(memory.in_flight)
        self.history.restore(memory.history, memory.passed)
        self._ended.clear()
        self._ended.extend(memory.ended_processes)
        self._off = None

    @property
    def q_cmd(self) -> Array:
        """(n,) present setpoint [rad or m]."""
        return self.history.newest

    @property
    def is_known(self) -> bool:
        """Whether all setpoints that still affect the drives are known: states came for as long as they lag."""
        return self.state is not None and self.history.is_full

    def admitted(self, admission: Admission) -> None:
        """Note a sent admission, which follows all in flight."""
        self._fly((*self.in_flight, admission))

    def _fly(self, admissions: tuple[Admission, ...]) -> None:
        self.in_flight = admissions
        self._decided_after = self._ahead = self._known_courses = self._present = None

    def decide_after(self, cycle: int | None) -> None:
        """Decide next the setpoint after `cycle`; None: the one for answers to the newest state."""
        self._decided_after, self._ahead = cycle, None

    @property
    def decided_after(self) -> int:
        """The setpoint to decide next is sent after this cycle."""
        assert self.state is not None  # asked only of robots that have been heard
        answer = self.state.cycle + self._lookahead_cycles - 1
        return answer if self._decided_after is None else self._decided_after

    @property
    def ahead(self) -> SetpointMotion:
        """The robot's motion (setpoint, increment, brake) after all admissions in flight, if it takes them all."""
        return self._motions()[-1]

    def brake(self) -> Array:
        """(n,) increment that the Robot Server sends if nothing is admitted for the cycle that is decided next."""
        return self.ahead.brake()

    def course(self, dq: Array, brake_cycles: int) -> Branch:
        """The course of `dq` (n,) and its brake after all admissions in flight."""
        return Branch(dq, brake_cycles, -1, tuple(motion.q_cmd for motion in self._motions()[1:]))

    def _motions(self) -> list[SetpointMotion]:
        if self._ahead is None:
            assert self.state is not None  # asked only of robots that have been heard
            cycles = self.decided_after - self.state.cycle
            self._ahead = motions(self._now(), self.state.cycle, self.in_flight, cycles)
        return self._ahead

    def _now(self) -> SetpointMotion:
        if self._present is None:
            assert self.state is not None  # asked only of robots that have been heard
            self._present = replace(SetpointMotion.of(self.state), q_cmd=self.q_cmd)
        return self._present

    def tube(self, branch: Branch) -> Windows:
        """The tube of one course from the present setpoint."""
        assert self.state is not None  # asked only of robots that have been heard
        measured = None if self.off_path() is None else np.array(self.state.q)
        return tube(self.history.array(), branch, self.drives, measured)

    def before(self) -> Windows:
        """The tube of all admissions in flight, to which the next course is added."""
        return self.tube(self.course(np.zeros_like(self.q_cmd), 1))

    def farthest(self) -> Array:
        """(n,) greatest distance of each joint from zero within the position limits (I1) [rad or m].

        A joint that stands outside its limits goes no further out.
        """
        assert self.state is not None  # asked only of robots that have been heard
        known = np.abs(np.vstack([self.history.array(), self.state.q]))
        farthest: Array = np.maximum(known.max(axis=0), self._limits)
        return farthest + self.drives.tolerance + self.drives.spread * self._fastest

    def tube_of_setpoints(self, branch: Branch) -> Windows:
        """The tube for drives exactly in the hull of their setpoints, regardless of the measured configuration."""
        exact = replace(self.drives, tolerance=np.zeros_like(self.drives.tolerance), spread=0.0)
        return tube(self.history.array(), branch, exact)

    def tubes(self) -> list[Windows]:
        """The tube of each candidate trajectory of the robot."""
        return [self.tube(branch) for branch in self._courses()]

    def tubes_of_setpoints(self) -> list[Windows]:
        """The tubes for drives exactly in the hull of their setpoints, without width."""
        return [self.tube_of_setpoints(branch) for branch in self._courses()]

    def _courses(self) -> list[Branch]:
        if self._known_courses is None:
            assert self.state is not None  # asked only of robots that have been heard
            self._known_courses = list(courses(self._now(), self.state.cycle, self.in_flight).values())
        return self._known_courses

    def standing(self) -> Windows:
        """The tube of a robot that gets no further increment: where its drives may be now."""
        return self.tube(Branch(np.zeros_like(self.q_cmd), 1, 0))

    def at_rest(self) -> bool:
        """Whether nothing is left to send and the drives have caught up."""
        brake, *_ = self._courses()
        return self.history.rests and not brake.setpoints(self.q_cmd).size

    def stands_still(self) -> bool:
        """Whether it is at rest, and nothing is in flight that could set it in motion."""
        return not self.in_flight and self.at_rest()

    def off_path(self) -> tuple[int, float, float] | None:
        """The joint that left the certified band around the commanded path: index, distance, bound [rad or m]."""
        if self._off is None:
            assert self.state is not None  # asked only of robots that have been heard
            history = self.history.array()
            allowed = widths(history, self.drives.tolerance, self.drives.spread)
            distance = np.abs(off_hull(history, np.array(self.state.q), allowed))
            joint = int((distance / allowed).argmax())
            self._off = joint, float(distance[joint]), float(allowed[joint])
        return None if self._off[1] <= self._off[2] * (1 + _SUMS) else self._off


def _stood(before: ServerState, state: ServerState) -> bool:
    """Whether the KRC missed the reply before this state, so that the same setpoint was sent again."""
    return any(state.dq) and state.q_cmd == before.q_cmd and state.cycle == before.cycle + 1


def _missed(state: ServerState, chain: Sequence[Admission]) -> int:
    """How many admissions of a chain lie behind the one that a state follows."""
    taken = [
        index for index, one in enumerate(chain) if (one.epoch, one.sequence) == (state.epoch, state.sequence)
    ]
    return len(chain) - (taken[-1] + 1 if taken else 0)
