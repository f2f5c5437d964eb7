"""An error in the middle of a core: the n-th call of a function of some packages raises."""

import inspect
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class InjectedError(Exception):
    """Nobody foresaw it."""


class Calls:
    """Counts calls of functions of packages, of which one raises.

    Attributes:
        count: calls so far.
    """

    def __init__(self, packages: tuple[str, ...], raises_at: int | None) -> None:
        self._packages, self._raises_at = packages, raises_at
        self.count = 0

    def event(self, frame: FrameType, event: str, _: object) -> None:
        if event != "call" or not frame.f_globals.get("__name__", "").startswith(self._packages):
            return
        if frame.f_code.co_flags & inspect.CO_GENERATOR:
            return  # one that is thrown away is called once more, where nobody hears of an error
        self.count += 1
        if self.count == self._raises_at:
            raise InjectedError(f"in {frame.f_code.co_qualname}")


@contextmanager
def error_in_call(number: int | None, *packages: str) -> Iterator[Calls]:
    """Within the block the call of this number raises `InjectedError`; None: calls are counted alone."""
    calls = Calls(packages, number)
    sys.setprofile(calls.event)
    try:
        yield calls
    finally:
        sys.setprofile(None)
