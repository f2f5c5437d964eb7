"""A controller in virtual time that answers each state as it comes, and says what setpoints it reckoned with."""

from collections.abc import Callable

import numpy as np
from leasing_client import LeasingClient

from deltaq_protocol.arrays import Array
from deltaq_protocol.in_flight import Ahead, InFlight
from deltaq_protocol.messages import Message, RobotState, Verdict


class AnsweringClient(LeasingClient):
    """Answers the states of a robot without waiting for verdicts, or with waiting for the one before.

    Args:
        say: sends to the HLI.
        robot: that it drives.
        increment: makes an increment (n,) [rad or m] from what it is added to.
        waits: for the verdict on each increment before it answers another state, for up to four cycles.

    Attributes:
        hears: is asked of each verdict whether it comes to the controller.
        expected: by cycle, the setpoint (n,) that it reckoned with last [rad or m].
        counted: first verdicts that came, by outcome, and `given up`.
    """

    def __init__(
        self,
        say: Callable[[Message], None],
        robot: str,
        increment: Callable[[Ahead], Array],
        waits: bool = False,
    ) -> None:
        super().__init__(say, robot)
        self.hears: Callable[[Verdict], bool] = lambda _: True
        self.in_flight = InFlight()
        self.expected: dict[int, Array] = {}
        self.counted: dict[str, int] = {}
        self._increment, self._waits = increment, waits
        self._awaited: tuple[int, int] | None = None
        self._unanswered: RobotState | None = None

    def take_verdict(self, verdict: Verdict) -> None:
        if self.hears(verdict):
            self.tell(verdict)

    def tell(self, verdict: Verdict) -> None:
        """A verdict comes to the controller."""
        if self._awaited is not None and self._awaited[0] == verdict.seq:
            self._awaited = None
        if self.in_flight.take(verdict):
            self._count(verdict.outcome.value)
        if self._waits and self._unanswered is not None:
            self.take_state(self._unanswered)

    def take_state(self, state: RobotState) -> None:
        self._unanswered = state
        if self._waits and self._awaited is not None and state.cycle < self._awaited[1] + 4:
            return
        self._unanswered = None
        cycles = self.in_flight.cycles_to_answer(state)
        for cycle in cycles[-1:] if self._waits else cycles:
            ahead = self.in_flight.ahead(state)
            self.expected[ahead.cycle] = ahead.q_cmd
            dq = np.array(self._increment(ahead))
            self._seq += 1
            # before it is sent: on a perfect wire the verdict comes while it is
            self.in_flight.sent(self._seq, dq, cycle)
            self._awaited = self._seq, state.cycle
            self.ask(cycle, tuple(dq.tolist()))
        for _ in range(self.in_flight.take_given_up()):
            self._count("given up")

    def _count(self, what: str) -> None:
        self.counted[what] = self.counted.get(what, 0) + 1
