"""The page of sequences: what an increment, a stop and a reset make the services say, from a traced run.

The cell runs in virtual time, with the services' own cores; what is drawn is what they said, in its order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import Message, RobotState
from deltaq_services.outputs import Output, Sender, ToSender
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.parts import Link, Process

_ROBOT = "fr"
_CLIENT, _HLI, _SIM, _SERVER = "client", "HLI", "SIM", "RobotServer"
_NAMES = {Process.HLI: _HLI, Process.SIM: _SIM, Process.ROBOT_SERVER: _SERVER}
_ENDS: Final = {
    Link.HLI_SIM: {_HLI, _SIM},
    Link.HLI_SERVER: {_HLI, _SERVER},
    Link.SIM_SERVER: {_SIM, _SERVER},
}

_TOLD = ("phase", "outcome", "action", "verb")
"""Fields that say what is going on."""
_MOST_CYCLES = 20
_REST_CYCLES = 60
"""Enough for a robot that was stopped to rest, and its drives to follow."""

Said = tuple[str, str, str]
"""Who said what to whom: from, to, what."""


class _TracedCell(VirtualCell):
    """Notes every message about one robot, and those about none."""

    def __init__(self, cell: str) -> None:
        self.said: list[Said] = []
        super().__init__(cell)

    def carry_out(self, outputs: list[Output]) -> None:
        for output in outputs:
            if isinstance(output, ToSender) or isinstance(output.message, RobotState):
                self._note(_HLI, _CLIENT, output.message)
            super().carry_out([output])

    def _send(self, link: Link, to: Process, message: Message) -> None:
        (origin,) = _ENDS[link] - {_NAMES[to]}
        self._note(origin, _NAMES[to], message)
        super()._send(link, to, message)

    def _to_hli(self, said: Message | InvalidMessageError, sender: Sender | None) -> None:
        if sender is not None and isinstance(said, Message):
            self._note(_CLIENT, _HLI, said)
        super()._to_hli(said, sender)

    def _note(self, origin: str, to: str, message: Message) -> None:
        if getattr(message, "robot", None) in (_ROBOT, None, ""):
            self.said.append((origin, to, _what(message)))


def sequences() -> str:
    """The diagrams of an increment, a stop and a reset."""
    cell = _TracedCell("lab")
    cell.run_until_ready()
    cell.acquire(_ROBOT, "controller")
    dq = np.zeros(cell.cell.robots[_ROBOT].n)
    dq[0] = 1e-4
    asked = _traced(cell, lambda: cell.ask(_ROBOT, dq), cycles=1)
    stopped = _traced(cell, cell.stop, until="Done")
    for _ in range(_REST_CYCLES):
        cell.cycle()
    reset = _traced(cell, lambda: cell.reset(_ROBOT), until="Done")
    return "\n\n".join(
        [
            "# Who says what, in which order",
            "Drawn from a run of the lab cell in virtual time, with the cores that run in the services; of its messages"
            f" those about `{_ROBOT}`, and those about no robot. Telegrams between the KRC and its Robot Server are"
            " left out: each `ServerState` follows one. [The loop](../explanation/the-loop.md) explains the steps.",
            "## An increment",
            _diagram(asked),
            "## A stop",
            _diagram(stopped),
            "## A reset of the robot that the stop held",
            _diagram(reset),
        ]
    )


def _traced(
    cell: _TracedCell, do: Callable[[], object], cycles: int = _MOST_CYCLES, until: str = ""
) -> list[Said]:
    """What is said in one cycle, by what is done then, and in the cycles after it until somebody says a word."""
    cell.said = []
    cell.cycle()
    do()
    for _ in range(cycles):
        if until and any(what.startswith(until) for _, _, what in cell.said):
            break
        cell.cycle()
    return list(cell.said)


def _what(message: Message) -> str:
    """The name of a message, and of what may be told about it in a word."""
    if isinstance(message, Request):
        return f"Request, {'a heartbeat' if message.dq is None else 'an increment'}"
    told = [str(value) for name in _TOLD if (value := getattr(message, name, None)) not in (None, "")]
    return ", ".join([type(message).__name__, *told])


def _diagram(said: list[Said]) -> str:
    parties = [f"    participant {name}" for name in (_CLIENT, _HLI, _SIM, _SERVER)]
    arrows = [f"    {origin}->>{to}: {what}" for origin, to, what in said]
    return "\n".join(["```mermaid", "sequenceDiagram", *parties, *arrows, "```"])
