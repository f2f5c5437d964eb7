"""The console's log: lines as they come, those that repeat counted instead of told again."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Literal

from deltaq_services.console.messages import ConsoleEvent

KEPT = 200
"""Newest lines, which a new client is told."""
QUIET_S = 2.0
"""A line that comes again within this is counted, and told with its count when the time is over."""

EventKind = Literal["verdict", "lease", "stop", "phase", "link", "client", "recording", "view"]


class EventLog:
    """Lines of the log; each reader gets the lines that are new."""

    def __init__(self) -> None:
        self._kept: deque[ConsoleEvent] = deque(maxlen=KEPT)
        self._new: list[ConsoleEvent] = []
        self._quiet: dict[tuple[EventKind, str, str], tuple[float, int, ConsoleEvent]] = {}

    def add(self, now_s: float, kind: EventKind, text: str, robot: str = "") -> None:
        """A line, told at once."""
        self._tell(ConsoleEvent(time_s=now_s, kind=kind, robot=robot, text=text))

    def repeat(self, now_s: float, kind: EventKind, group: str, text: str, robot: str = "") -> None:
        """A line that may come every cycle: lines of one group count as one line while they keep coming."""
        key = (kind, robot, group)
        event = ConsoleEvent(time_s=now_s, kind=kind, robot=robot, text=text)
        if key in self._quiet:
            until_s, count, _ = self._quiet[key]
            self._quiet[key] = (until_s, count + 1, event)
        else:
            self._quiet[key] = (now_s + QUIET_S, 0, event)
            self._tell(event)

    def news(self, now_s: float) -> list[ConsoleEvent]:
        """Lines since this was asked last."""
        for key, (until_s, count, event) in list(self._quiet.items()):
            if now_s < until_s:
                continue
            if count:
                self._tell(event.model_copy(update={"count": count}))
                self._quiet[key] = (now_s + QUIET_S, 0, event)
            else:
                del self._quiet[key]
        new, self._new = self._new, []
        self._kept.extend(new)
        return new

    @property
    def kept(self) -> Iterable[ConsoleEvent]:
        """The newest lines that were asked for, oldest first."""
        return tuple(self._kept)

    def _tell(self, event: ConsoleEvent) -> None:
        self._new.append(event)
