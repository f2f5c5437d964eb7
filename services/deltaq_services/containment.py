"""Copies of cores: a copy behaves like its original, and after an error a core is restored.

A message on which a core fails then counts as lost, which every core must tolerate at any time.

A snapshot before each message would cost a fifth of what the message costs, copies of the attributes cost a sixth of
that: their values are never written to, and where they are lists, maps, sets or deques these are copied too.
"""

import logging
import traceback
from collections import Counter, deque
from collections.abc import Iterable
from typing import Any, ClassVar, Self

_WRITTEN_TO = (list, dict, set, deque)
_MOST_PLACES = 64
"""Number of places in the code whose errors are logged separately."""


class Part:
    """A part of a core. Its attributes are parts, values that are never written to, and flat containers of both.

    Attributes:
        aside: names of attributes that are no part of the value: they only look at it.
    """

    aside: ClassVar[frozenset[str]] = frozenset()

    def snapshot(self) -> Self:
        """A copy, for `restore`; counters, callables and attributes in `aside` are shared, not copied."""
        copy = object.__new__(type(self))
        copy.__dict__.update((name, _copied(value)) for name, value in self.__dict__.items())
        return copy

    def restore(self, memory: Self) -> None:
        """Restore the state in `memory`, taken of another part with the same robots; counters are kept."""
        for name, value in memory.__dict__.items():
            own = self.__dict__.get(name)
            if name in self.aside or callable(value) or isinstance(value, Counter | Containment):
                continue
            if isinstance(own, Part) and type(own) is type(value):
                own.restore(value)
            else:
                self.__dict__[name] = _copied(value)


def _copied(value: Any) -> Any:
    if isinstance(value, Part):
        return value.snapshot()
    if type(value) is dict:
        return {key: one.snapshot() if isinstance(one, Part) else one for key, one in value.items()}
    return value.copy() if type(value) in _WRITTEN_TO else value


class Containment:
    """Restores the objects of a core after an error.

    Attributes:
        failed: whether an error occurred since the last call of `remember`.
        traceback: of the newest error that was not logged yet; empty if there was none.
    """

    def __init__(self) -> None:
        self._containers: dict[type, tuple[str, ...]] = {}
        self._kept: list[tuple[object, dict[str, Any]]] = []
        self._logged: set[tuple[str, ...]] = set()
        self._place: tuple[str, ...] = ()
        self.failed = False
        self.traceback = ""

    def remember(self, parts: Iterable[object]) -> None:
        """Remember the present state of all parts that may change.

        Args:
            parts: the objects, as they are now. Their attributes are values, and flat containers of values that are
                there from the beginning; whatever else is reached through them is a part of its own. Counters are not
                put back.
        """
        kept = []
        for part in parts:
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
        """Restore the parts to the last call of `remember`."""
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
