"""The interface behind keyboard, gamepad, SpaceMouse, master arm, script and options."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

from deltaq_controllers.modes.motion import OperatorCommand


class OperatorInput(Protocol):
    """Source of an operator's commands; a context manager, since some hold a device."""

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command at a time of the robot's clock [s]; empty while no input is touched, None at the end."""
        ...

    @property
    def status(self) -> str:
        """The present choice, for the operator."""
        return ""

    def reflect(self, share: float) -> None:
        """Let the operator's hand feel which fraction of the requested motion goes through, 0 to 1."""
        del share

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
