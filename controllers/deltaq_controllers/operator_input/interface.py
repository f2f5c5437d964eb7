"""The interface behind keyboard, gamepad, script and options."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

from deltaq_controllers.modes.motion import Wish


class OperatorInput(Protocol):
    """Source of an operator's wishes; a context manager, since some hold a device."""

    def read(self, time_s: float) -> Wish | None:
        """The wish at a time of the robot's clock [s]; empty while nobody touches anything, None when it is over."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
