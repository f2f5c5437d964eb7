"""Sends a controller's increments and takes their verdicts, with a lookahead and without.

In a cell with a lookahead the verdict may take longer than a cycle: each state is answered at once, and increments in
flight are added (`deltaq_protocol.in_flight`). Without a lookahead (`q_ahead` is null) each verdict is awaited before
the next state is answered: not waiting gained nothing in a running cell (docs/notes/timing.md). If the round trip
takes longer, the lease asks for a jitter buffer, and the increments waiting there are in flight, too.
"""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.robot_clocks import ClockReading, RobotClocks
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.in_flight import PATIENCE_CYCLES, Ahead, InFlight, is_awaited
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import RobotState, Verdict
from deltaq_protocol.opening import Opening


async def lease(cell: Cell, robot: str) -> Opening[LeasedRobot]:
    """A lease for `Answers`: with a jitter buffer if the round trip takes longer than answers may.

    Raises:
        RefusedError: the cell has no such robot.
        ServiceUnreachableError: the HLI is gone.
    """
    state = cell.state(robot)
    ahead = 1 if state is None or state.setpoint_cycle is None else state.setpoint_cycle - state.cycle
    is_far = await cell.round_trip_s() > max(1, ahead) * cell.description.cycle_s
    return cell.lease(robot, playout=is_far)


_PATIENCE, _MOST_PATIENCE = 100, 10_000
"""Late answers in a row before a state is left out, at first and at most (two minutes at 12 ms). Where
it is in vain, it costs a cycle of the brake."""


class CatchUp:
    """Decides which state to leave unanswered if every increment is decided one state late. Pure.

    After one late increment, each later one waits in the gate for the next state. If the controller leaves one state
    unanswered, the waiting increment takes that cycle, and the next answer is decided at once. If increments become
    late again, the machine or the link is too slow: the next state is left out after twice as many answers.
    """

    def __init__(self) -> None:
        self._behind, self._patience = 0, _PATIENCE

    def leaves_out(self, state: RobotState, before: Verdict | None) -> bool:
        """Whether to leave a state without an answer; `before` is the verdict on the increment before."""
        setpoint_cycle = None if before is None else before.setpoint_cycle
        self._behind = self._behind + 1 if setpoint_cycle is not None and setpoint_cycle > state.cycle else 0
        if self._behind < self._patience:
            return False
        self._behind, self._patience = 0, min(2 * self._patience, _MOST_PATIENCE)
        return True


class Answers:
    """Answers the states of one robot.

    Args:
        cell: connection to the cell.
        leased: the robot.
        reading: reads the robots' clocks, a little with each state; None for a reading of its own.
    """

    def __init__(self, cell: Cell, leased: LeasedRobot, reading: ClockReading | None = None) -> None:
        self._cell, self._leased = cell, leased
        self._reading = reading or ClockReading(cell)
        self._in_flight = InFlight()
        self._awaited: Verdict | None = None
        self._before: Verdict | None = None
        self._come: list[Verdict | None] = []
        self._catch_up = CatchUp()

    async def due(self, state: RobotState) -> Sequence[int]:
        """The cycles for which to send increments now.

        Usually that is the state's own cycle. With a lookahead, cycles of missed states are due as well, if their
        answers are still in time. Without one, no cycle is due if `CatchUp` leaves the state out.

        Args:
            state: newer than all before it.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the HLI is gone.
        """
        self._reading.go_on()
        if is_awaited(state):
            self._before, self._awaited = self._awaited, None
            return () if self._catch_up.leaves_out(state, self._before) else (state.cycle,)
        self._come += [v for v in await self._leased.new_verdicts() if self._in_flight.take(v)]
        return self._in_flight.cycles_to_answer(state)

    def own(self, state: RobotState) -> RobotView:
        """The robot after all increments in flight, to which the next increment is added; valid after `due`."""
        if is_awaited(state):
            return own_view(state, self._before)
        return view_ahead(state, self._in_flight.ahead(state))

    def view(self, state: RobotState) -> View:
        """The own robot as in `own`, and the newest states of all other robots with known clocks."""
        return view_of(self._cell, state.robot, self.own(state), self._reading.clocks)

    async def send(self, state: RobotState, cycle: int, dq: Array) -> None:
        """Send an increment (n,) for a cycle that is due [rad or m]; without a lookahead wait for its verdict.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the HLI is gone. A missing verdict is not an error.
        """
        if not is_awaited(state):
            self._in_flight.sent(await self._leased.send(dq.tolist(), cycle), dq, cycle)
            return
        with suppress(TimeoutError, ServiceUnreachableError):
            async with asyncio.timeout(PATIENCE_CYCLES * self._cell.description.cycle_s):
                self._awaited = await self._leased.move(dq.tolist())
        self._come.append(self._awaited)

    def verdicts(self) -> list[Verdict | None]:
        """First verdicts on increments since the last call; None for each lost one."""
        come, self._come = self._come, []
        return come + [None] * self._in_flight.take_given_up()


def view_ahead(state: RobotState, ahead: Ahead) -> RobotView:
    """The moved robot after all increments in flight, to which the next increment is added."""
    ahead_cycles = ahead.cycle - state.cycle
    return RobotView(ahead.cycle, state.time_s, np.array(state.q), ahead.q_cmd, ahead_cycles, ahead.dq)


def own_view(state: RobotState, verdict: Verdict | None = None) -> RobotView:
    """The controller's own robot, from its newest state.

    Args:
        state: its newest.
        verdict: the newest verdict on it; an admitted increment that the state does not show yet is in flight.
    """
    own = RobotView.from_state(state)
    if verdict is not None and verdict.dq and verdict.cycle >= state.cycle:
        own = own.after(verdict.cycle, np.array(verdict.dq))
    return own


def view_of(cell: Cell, robot: str, own: RobotView, clocks: RobotClocks) -> View:
    """The view of a controller: its own robot, and the newest states of all others, stamped on the own robot's clock.

    A robot without a state, or with an unknown clock, is left out: the age of its state is unknown.
    """
    others = {}
    for name in cell.robots:
        state = cell.state(name)
        if name == robot or state is None:
            continue
        time_s = clocks.on_clock_of(robot, name, state.time_s)
        if time_s is not None:
            others[name] = replace(RobotView.from_state(state), time_s=time_s)
    return View(own, others)
