"""What a core does after an error that nobody foresaw: it is put back to what it was before the message.

A message that a core fails on is then as one that was lost on its way, which every core has to bear at any time.

A snapshot before each message would cost a fifth of what the message costs, copies of the attributes cost a sixth of
that: their values are never written to, and where they are lists, maps, sets or deques these are copied too.
"""

from __future__ import annotations

import logging
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

_WRITTEN_TO = (list, dict, set, deque)
_MOST_PLACES = 64
"""Places in the code whose errors are told apart; with more of them the log is full enough."""


class Containment:
    """Puts the objects that make up a core back to what they were.

    Args:
        parts: the objects, as they are now. Their attributes are values, and flat containers of values that are there
            from the beginning; whatever else is reached through them is a part of its own. Counters are not put back.

    Attributes:
        failed: whether an error befell since `remember` was called last.
        traceback: of the newest error that was not logged yet; empty if there was none.
    """

    def __init__(self, parts: Callable[[], Iterable[object]]) -> None:
        self._parts = parts
        self._containers: dict[type, tuple[str, ...]] = {}
        self._kept: list[tuple[object, dict[str, Any]]] = []
        self._logged: set[tuple[str, ...]] = set()
        self._place: tuple[str, ...] = ()
        self.failed = False
        self.traceback = ""

    def remember(self) -> None:
        """Remember what the parts are now."""
        kept = []
        for part in self._parts():
            attributes = part.__dict__.copy()
            try:
                names = self._containers[part.__class__]
            except KeyError:
                names = tuple(name for name, value in attributes.items() if type(value) in _WRITTEN_TO)
                self._containers[part.__class__] = names
            for name in names:
                attributes[name] = attributes[name].copy()
            kept.append((part, attributes))
        self._kept, self.failed = kept, False

    def put_back(self) -> None:
        """Make the parts what they were when `remember` was called last."""
        for part, attributes in self._kept:
            vars(part).clear()
            vars(part).update(attributes)
        self._kept = []

    def note(self, error: Exception) -> None:
        """Note an error, whose traceback is to be logged."""
        self.failed = True
        frames = [
            f"{frame.f_code.co_filename}:{line}" for frame, line in traceback.walk_tb(error.__traceback__)
        ]
        self._place = type(error).__name__, *frames
        if self._place not in self._logged and len(self._logged) < _MOST_PLACES:
            self.traceback = "".join(traceback.format_exception(error))

    def log_once(self, log: logging.Logger) -> None:
        """Log the traceback of the newest error, unless one from the same place was logged before."""
        if self.traceback:
            self._logged.add(self._place)
            log.error("a message that failed here was refused (internal_errors):\n%s", self.traceback)
            self.traceback = ""
