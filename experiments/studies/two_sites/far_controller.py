"""Controllers far away in virtual time: what a link makes of messages that delays and loses packets, and who answers.

`studies.two_sites` does the same over real processes and the kernel's own TCP.
"""

import heapq
import random
from collections import deque
from itertools import count

from deltaq_controllers.answers import view_ahead
from deltaq_controllers.interface import Controller, RobotView, View
from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.in_flight import InFlight
from deltaq_protocol.leased_robot import REPEATED
from deltaq_protocol.messages import (
    EarlierIncrement,
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    RobotState,
    Verdict,
)
from deltaq_testing.virtual_cell.clients import Say
from deltaq_testing.virtual_cell.parts import MessageWire

_STREAMS = (Increment, RobotState, Verdict)


class FarWire(MessageWire):
    """One direction of a connection over a link in which no packet overtakes another.

    Over TCP a message whose packet is lost comes a round trip later, once three packets behind it have shown that it is
    missing, and those behind it wait for it. With datagrams that is so for leases alone: what is lost of the streams is
    lost, and nothing waits.

    Args:
        datagrams: whether streams go as such.
        delay_s, jitter_s: of a packet: as much, more or less as much.
        loss_share: of packets.
        spacing_s: between two packets.
        seed: of the random numbers.

    Attributes:
        lost: packets so far.
        cut_until_s: time until which nothing passes; over TCP it comes afterwards.
    """

    def __init__(
        self,
        datagrams: bool,
        delay_s: float,
        jitter_s: float,
        loss_share: float,
        spacing_s: float,
        seed: int,
    ) -> None:
        self._datagrams = datagrams
        self._random = random.Random(seed)
        self._delay_s, self._jitter_s, self._loss_share = delay_s, jitter_s, loss_share
        self._again_s = 2 * delay_s + 3 * spacing_s
        self._under_way: list[tuple[float, int, Message]] = []
        self._latest_s = {True: 0.0, False: 0.0}
        self._number = count()
        self.lost, self.cut_until_s = 0, 0.0
        self.link = _Due(self._under_way)

    def send(self, now_s: float, message: Message) -> None:
        """Put a message in."""
        due_s = now_s + self._delay_s + self._random.uniform(-self._jitter_s, self._jitter_s)
        is_datagram = self._datagrams and isinstance(message, _STREAMS)
        if now_s < self.cut_until_s:
            self.lost += 1
            if is_datagram:
                return
            due_s = max(due_s, self.cut_until_s + self._again_s)
        while self._random.random() < self._loss_share:
            self.lost += 1
            if is_datagram:
                return
            due_s += self._again_s
        due_s = self._latest_s[is_datagram] = max(due_s, self._latest_s[is_datagram])
        heapq.heappush(self._under_way, (due_s, next(self._number), message))

    def take(self, now_s: float) -> list[Message]:
        """Take out what has arrived by now, in order."""
        messages = []
        while self._under_way and self._under_way[0][0] <= now_s:
            messages.append(heapq.heappop(self._under_way)[2])
        return messages


class _Due(FaultyLink):
    """Tells the cell when the next message arrives."""

    def __init__(self, under_way: list[tuple[float, int, Message]]) -> None:
        super().__init__()
        self.faults = LinkFaults(delay_s=1e-9)  # it is no perfect wire
        self._under_way = under_way

    @property
    def next_s(self) -> float | None:
        return self._under_way[0][0] if self._under_way else None


class Watcher:
    """Keeps the newest state of a robot.

    Attributes:
        robot: that is watched.
        token: None: it holds no lease.
        state: the newest; None before the first.
    """

    def __init__(self, _say: Say, robot: str) -> None:
        self.robot = robot
        self.token: str | None = None
        self.state: RobotState | None = None

    def take(self, message: Message) -> None:
        """The HLI has said something."""
        if isinstance(message, RobotState):
            self.state = message


class FarController:
    """Answers each state of a robot as it comes, as `deltaq_controllers.answers` does with a playout buffer.

    Args:
        say: sends to the HLI.
        robot: that it drives.
        controller: makes the increments.
        other: watches the other robot.

    Attributes:
        robot: that it drives.
        token: of its lease; None without one.
    """

    def __init__(self, say: Say, robot: str, controller: Controller, other: Watcher) -> None:
        self.robot = robot
        self.token: str | None = None
        self._say, self._controller, self._other = say, controller, other
        self._in_flight = InFlight()
        self._seq = 0
        self._earlier: deque[EarlierIncrement] = deque(maxlen=REPEATED)
        say(LeaseRequest(robot=robot, action=LeaseAction.ACQUIRE, client=f"far-{robot}", playout=True))

    def take(self, message: Message) -> None:
        """The HLI has said something."""
        if isinstance(message, LeaseReply):
            self.token = message.lease
        elif isinstance(message, Verdict):
            self._in_flight.take(message)
        elif isinstance(message, RobotState) and self.token is not None:
            self._answer(message)

    def _answer(self, state: RobotState) -> None:
        other = self._other.state
        if other is None:
            return
        for cycle in self._in_flight.cycles_to_answer(state):
            own = view_ahead(state, self._in_flight.ahead(state))
            dq = self._controller.increment(View(own, {other.robot: RobotView.from_state(other)}))
            self._seq += 1
            self._in_flight.sent(self._seq, dq, cycle)
            asked = tuple(dq.tolist())
            self._say(
                Increment(
                    robot=self.robot,
                    seq=self._seq,
                    cycle=cycle,
                    dq=asked,
                    lease=self.token,
                    earlier=tuple(self._earlier),
                )
            )
            self._earlier.append(EarlierIncrement(seq=self._seq, cycle=cycle, dq=asked))
        self._in_flight.take_given_up()
