"""Wires between the cores of the lockstep runner: perfect ones, and ones that lose, delay, duplicate and reorder."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

T = TypeVar("T")


class Wire(Protocol[T]):
    """Carries messages from one core to another."""

    def send(self, message: T) -> None:
        """Put a message in."""
        ...

    def arrived(self) -> list[T]:
        """Take out what has arrived by this cycle, oldest arrival first; called once a cycle."""
        ...


class PerfectWire(Generic[T]):
    """Everything arrives, at once and in order."""

    def __init__(self) -> None:
        self._messages: list[T] = []

    def send(self, message: T) -> None:
        """Put a message in."""
        self._messages.append(message)

    def arrived(self) -> list[T]:
        """Take everything out."""
        messages, self._messages = self._messages, []
        return messages


@dataclass(frozen=True)
class Impairment:
    """Chances of a message, and how many cycles late it may be; late messages overtake one another."""

    loss: float = 0.0
    delay: float = 0.0
    duplicate: float = 0.0
    most_cycles_late: int = 8


class FaultyWire(Generic[T]):
    """Loses, delays, duplicates and reorders, as a seed decides."""

    def __init__(self, impairment: Impairment, random: np.random.Generator) -> None:
        self._impairment = impairment
        self._random = random
        self._cycle = 0
        self._count = 0
        self._under_way: list[tuple[int, int, T]] = []

    def send(self, message: T) -> None:
        """Put a message in; it may never come out, or twice."""
        chances = self._random.random(3)
        if chances[0] < self._impairment.loss:
            return
        for _ in range(2 if chances[1] < self._impairment.duplicate else 1):
            late = 0
            if chances[2] < self._impairment.delay:
                late = int(self._random.integers(1, self._impairment.most_cycles_late + 1))
            self._count += 1
            heapq.heappush(self._under_way, (self._cycle + late, self._count, message))

    def arrived(self) -> list[T]:
        """Take out what is due."""
        messages = []
        while self._under_way and self._under_way[0][0] <= self._cycle:
            messages.append(heapq.heappop(self._under_way)[2])
        self._cycle += 1
        return messages
