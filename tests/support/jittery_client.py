"""A controller in virtual time whose answers take as long as a distribution says, and wires that keep their order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from leasing_client import LeasingClient

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.messages import Message, RobotState, Verdict
from deltaq_verification.virtual_cell.wires import MessageWire


class _Queue(FaultyLink):
    """Tells the cell when the next message leaves."""

    def __init__(self, under_way: deque[tuple[float, Message]]) -> None:
        super().__init__()
        self.faults = LinkFaults(delay_s=1e-9)
        self._under_way = under_way

    @property
    def next_s(self) -> float | None:
        return self._under_way[0][0] if self._under_way else None


class DelayedWire(MessageWire):
    """One direction whose messages each take as long as is drawn, and none overtakes another, as over TCP.

    Args:
        delay_s: draws a delay [s].
    """

    def __init__(self, delay_s: Callable[[], float]) -> None:
        self._delay_s = delay_s
        self._under_way: deque[tuple[float, Message]] = deque()
        self.link = _Queue(self._under_way)

    def send(self, now_s: float, message: Message) -> None:
        behind_s = self._under_way[-1][0] if self._under_way else 0.0
        self._under_way.append((max(behind_s, now_s + self._delay_s()), message))

    def take(self, now_s: float) -> list[Message]:
        messages = []
        while self._under_way and self._under_way[0][0] <= now_s:
            messages.append(self._under_way.popleft()[1])
        return messages


class JitteryClient(LeasingClient):
    """Answers each state of a robot with the same increment, and keeps the verdicts.

    Args:
        say: sends to the HLI.
        robot: that it drives.
        dq: the increment [rad or m].
    """

    def __init__(self, say: Callable[[Message], None], robot: str, dq: tuple[float, ...]) -> None:
        super().__init__(say, robot)
        self.verdicts: list[Verdict] = []
        self._dq = dq

    def take_verdict(self, verdict: Verdict) -> None:
        self.verdicts.append(verdict)

    def take_state(self, state: RobotState) -> None:
        self._seq += 1
        self.ask(state.cycle, self._dq)
