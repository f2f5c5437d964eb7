"""Digital outputs of a robot as an operator switches them while it is driven, and its inputs: the shell around `io`."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import IoReply

LOOK_S = 0.5
"""Time after which outputs and inputs are read again [s]."""


@dataclass(frozen=True)
class Switched:
    """An output that was switched, or was to be.

    Attributes:
        output: its name.
        is_on: how it was to be.
        error: why it was not; empty if it was.
    """

    output: str
    is_on: bool
    error: str = ""

    def summary(self) -> dict[str, Any]:
        """As a JSON object."""
        return {"output": self.output, "on": self.is_on, "error": self.error or None}


@dataclass
class SignalLog:
    """The newest digital signals of a robot.

    Attributes:
        outputs, inputs: as last read, by name.
        switched: what was switched so far, in its order.
    """

    outputs: dict[str, bool] = field(default_factory=dict)
    inputs: dict[str, bool] = field(default_factory=dict)
    switched: list[Switched] = field(default_factory=list)

    @property
    def failed(self) -> list[Switched]:
        """Outputs that could not be switched."""
        return [each for each in self.switched if each.error]

    @property
    def status(self) -> str:
        """Outputs and inputs in a line, for people."""
        told = {**self.outputs, **self.inputs}
        return ", ".join(f"{name} {'on' if is_on else 'off'}" for name, is_on in told.items())


class Signals:
    """Switches outputs one after the other beside the control loop, and reads them again from time to time.

    A context manager for as long as the lease is held; what was asked for until its end is still switched.

    Args:
        leased: the robot.
        names: of its outputs and inputs; without any there is nothing to be read.
        log: what to keep account in.
    """

    def __init__(self, leased: LeasedRobot, names: tuple[str, ...], log: SignalLog) -> None:
        self._leased, self._has_any, self._log = leased, bool(names), log
        self._asked: dict[str, bool] = {}
        self._due: asyncio.Queue[Mapping[str, bool] | None] = asyncio.Queue()
        self._task: asyncio.Task[None] | None = None

    def ask(self, outputs: Mapping[str, bool]) -> None:
        """Have outputs switched; a command that lasts for many cycles counts once."""
        new = {name: is_on for name, is_on in outputs.items() if self._asked.get(name) is not is_on}
        if new:
            self._asked |= new
            self._due.put_nowait(new)

    async def __aenter__(self) -> Self:
        if self._has_any:
            self._due.put_nowait({})
            self._task = asyncio.create_task(self._serve())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Switch what is still due, unless the drive broke off."""
        if self._task is None:
            return
        if error is None:
            self._due.put_nowait(None)
            await self._task
        else:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _serve(self) -> None:
        while (outputs := await self._next()) is not None:
            await self._switch(outputs)

    async def _next(self) -> Mapping[str, bool] | None:
        with suppress(TimeoutError):
            async with asyncio.timeout(LOOK_S):
                return await self._due.get()
        return {}

    async def _switch(self, outputs: Mapping[str, bool]) -> None:
        """Set outputs, or read all of them; an error ends no drive, and the same can be asked for again."""
        told = ""
        try:
            reply: IoReply = await self._leased.io(outputs)
        except DeltaqError as error:
            told = str(error)
            for name in outputs:
                self._asked.pop(name, None)
        else:
            self._log.outputs, self._log.inputs = dict(reply.outputs), dict(reply.inputs)
        self._log.switched += [Switched(name, is_on, told) for name, is_on in outputs.items()]
