"""Faults of the network, as a queue in time: no clock is used here, and one seed is one run."""

import heapq
import math
import random
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Probability = Annotated[float, Field(ge=0, le=1)]
Seconds = Annotated[float, Field(ge=0, le=10)]

MAX_QUEUED = 10_000


class LinkFaults(BaseModel):
    """Faults of datagrams in one direction; none by default."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    drop: Probability = 0.0
    """Fraction that is lost."""
    duplicate: Probability = 0.0
    """Fraction that arrives twice."""
    reorder: Probability = 0.0
    """Fraction that is overtaken by the next one."""
    corrupt: Probability = 0.0
    """Fraction that has bytes changed, or its end cut off."""
    flip: Probability = 0.0
    """Fraction in which one digit becomes another: a telegram that is valid and says something else."""
    truncate: Probability = 0.0
    """Fraction that has its end cut off."""
    delay_s: Seconds = 0.0
    """Delay of each datagram."""
    jitter_s: Seconds = 0.0
    """Largest additional delay, uniformly distributed."""
    keeps_order: bool = False
    """Whether the jitter is that of a queue, in which none overtakes another; otherwise each has its own."""


class Forgery(BaseModel):
    """A forged telegram, sent to the PC right after the controller's own, from another socket.

    With nothing but an address it is the same telegram from a second sender; with a shift of the IPOC it is a second
    controller, or the beginning of a new session.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: Annotated[str, Field(pattern=r"^127(\.[0-9]{1,3}){3}$")] = "127.0.0.1"
    """Where it is sent from; only addresses of the loopback, on a port that the system chooses."""
    ipoc_shift: Annotated[int, Field(gt=-(2**32), lt=2**32)] = 0
    """By how much its IPOC is off."""
    offset_deg: Annotated[float, Field(ge=-3600, le=3600)] = 0.0
    """By how much every rotating axis is off in it."""
    programmed_too: bool = False
    """Whether the programmed position (ASPos) is off as well."""


class FaultyLink:
    """One direction of a network.

    Args:
        seed: of the random numbers that decide what happens to which datagram.

    Attributes:
        faults: may be set at any time.
        counts: faults so far.
    """

    def __init__(self, seed: int = 0) -> None:
        self.faults = LinkFaults()
        kinds = ("passed", "dropped", "duplicated", "reordered", "corrupted", "flipped", "truncated")
        self.counts = dict.fromkeys(kinds, 0)
        self._random = random.Random(seed)
        self._queue: list[tuple[float, int, bytes]] = []
        self._number = 0
        self._overtaken: list[tuple[float, bytes]] = []
        self._latest_due_s = -math.inf

    def put(self, now_s: float, datagram: bytes) -> None:
        """A datagram enters the link."""
        faults, draw = self.faults, self._random.random
        if len(self._queue) >= MAX_QUEUED or draw() < faults.drop:
            self.counts["dropped"] += 1
            return
        if draw() < faults.corrupt:
            datagram = self._damaged(datagram)
            self.counts["corrupted"] += 1
        # no random number is drawn for an absent fault, so that the runs of a seed stay the same
        if faults.flip and draw() < faults.flip:
            datagram = self._with_another_digit(datagram)
            self.counts["flipped"] += 1
        if faults.truncate and draw() < faults.truncate:
            datagram = datagram[: self._random.randrange(len(datagram) or 1)]
            self.counts["truncated"] += 1
        due_s = now_s + faults.delay_s + draw() * faults.jitter_s
        if faults.keeps_order:
            due_s = self._latest_due_s = max(due_s, self._latest_due_s)
        if draw() < faults.reorder:
            self._overtaken.append((due_s, datagram))
            self.counts["reordered"] += 1
            return
        self._enqueue(due_s, datagram)
        if draw() < faults.duplicate:
            self._enqueue(due_s, datagram)
            self.counts["duplicated"] += 1
        for overtaken_due_s, overtaken in self._overtaken:
            self._enqueue(max(due_s, overtaken_due_s), overtaken)
        self._overtaken.clear()

    def take(self, now_s: float) -> list[bytes]:
        """The datagrams that leave the link by now, in order."""
        out = []
        while self._queue and self._queue[0][0] <= now_s:
            out.append(heapq.heappop(self._queue)[2])
        self.counts["passed"] += len(out)
        return out

    @property
    def next_s(self) -> float | None:
        """Time at which the next datagram leaves [s], or None if none waits."""
        return self._queue[0][0] if self._queue else None

    def _enqueue(self, due_s: float, datagram: bytes) -> None:
        # the number keeps the order of datagrams that are due at the same time
        heapq.heappush(self._queue, (due_s, self._number, datagram))
        self._number += 1

    def _with_another_digit(self, datagram: bytes) -> bytes:
        places = [place for place, byte in enumerate(datagram) if 0x30 <= byte <= 0x39]
        if not places:
            return datagram
        place = self._random.choice(places)
        other = (datagram[place] - 0x30 + self._random.randint(1, 9)) % 10
        return datagram[:place] + b"%d" % other + datagram[place + 1 :]

    def _damaged(self, datagram: bytes) -> bytes:
        if not datagram:
            return b"?"
        damaged = bytearray(datagram)
        if self._random.random() < 0.5:
            del damaged[self._random.randrange(len(damaged)) :]
            return bytes(damaged)
        for place in self._random.sample(range(len(damaged)), min(len(damaged), self._random.randint(1, 4))):
            damaged[place] ^= self._random.randint(1, 255)
        return bytes(damaged)
