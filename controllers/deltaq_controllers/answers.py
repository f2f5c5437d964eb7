"""How a controller's increments go out and verdicts come back.

A verdict may take longer than a cycle. No state is left unanswered for that: each is answered as it comes, and what is
in flight is reckoned with (`deltaq_protocol.in_flight`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deltaq_controllers.interface import RobotView, View
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.in_flight import InFlight
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import RobotState, Verdict


class Answers:
    """Answers the states of one robot.

    Args:
        cell: connection to the cell.
        leased: the robot.
    """

    def __init__(self, cell: Cell, leased: LeasedRobot) -> None:
        self._cell, self._leased = cell, leased
        self._in_flight = InFlight()
        self._come: list[Verdict | None] = []

    async def due(self, state: RobotState) -> Sequence[int]:
        """The cycles for which increments are to be sent now.

        It is that of the state. With a lookahead it is also that of those before it that were missed, if there is room.

        Args:
            state: newer than all before it.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the HLI is gone.
        """
        self._come += [v for v in await self._leased.new_verdicts() if self._in_flight.take(v)]
        return self._in_flight.cycles_to_answer(state)

    def own(self, state: RobotState) -> RobotView:
        """The robot with all that is in flight, after `due`: what the next increment is added to."""
        ahead = self._in_flight.ahead(state)
        return RobotView(ahead.cycle, state.time_s, np.array(state.q), ahead.q_cmd)

    def view(self, state: RobotState) -> View:
        """The same, and the newest states of all others."""
        return view_of(self._cell, state.robot, self.own(state))

    async def send(self, cycle: int, dq: Array) -> None:
        """Send an increment (n,) for a cycle that is due [rad or m], and do not wait for its verdict.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the HLI is gone.
        """
        self._in_flight.sent(await self._leased.send(dq.tolist(), cycle), dq, cycle)

    def verdicts(self) -> list[Verdict | None]:
        """The first verdict on each increment of which it is known since the last call; None if it never came."""
        come, self._come = self._come, []
        return come + [None] * self._in_flight.take_given_up()


def view_of(cell: Cell, robot: str, own: RobotView) -> View:
    """The view of the robot that is moved, and the newest states of all others."""
    others = {name: cell.state(name) for name in cell.robots if name != robot}
    return View(
        own, {name: RobotView.from_state(other) for name, other in others.items() if other is not None}
    )
