"""The interface behind keyboard, gamepad, SpaceMouse, master arm, script and options."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

from deltaq_controllers.modes.motion import OperatorCommand


class OperatorInput(Protocol):
    """Source of an operator's commands; a context manager, since some hold a device."""

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command at a time of the robot's clock [s]; empty while nobody touches anything, None when it is over."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
