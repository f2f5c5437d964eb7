"""A controller in virtual time that answers every state, after times that its wires draw."""

from collections.abc import Callable

from leasing_client import LeasingClient

from deltaq_protocol.messages import Message, RobotState, Verdict


class JitteryClient(LeasingClient):
    """Answers each state of a robot with the same increment, and keeps the verdicts.

    Args:
        say: sends to the HLI.
        robot: that it drives.
        dq: the increment [rad or m].

    Attributes:
        verdicts: all that came.
        answered: by number of an increment, the cycle of the state that it answers.
    """

    def __init__(self, say: Callable[[Message], None], robot: str, dq: tuple[float, ...]) -> None:
        super().__init__(say, robot)
        self.verdicts: list[Verdict] = []
        self.answered: dict[int, int] = {}
        self._dq = dq

    def take_verdict(self, verdict: Verdict) -> None:
        """Keep it."""
        self.verdicts.append(verdict)

    def take_state(self, state: RobotState) -> None:
        """Answer it."""
        self._seq += 1
        self.answered[self._seq] = state.cycle
        self.ask(state.cycle, self._dq)
