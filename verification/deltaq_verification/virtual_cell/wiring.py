"""Which wire carries which message of a virtual cell; where none is plugged in, it arrives as it is sent."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from deltaq_emulator.faults import FaultyLink
from deltaq_protocol.guarded import Admission, Command, CommandReply, Request, Supervision
from deltaq_protocol.messages import Message, Verdict
from deltaq_verification.virtual_cell.parts import Link, Process
from deltaq_verification.virtual_cell.wires import MessageWire

GUARDED_WAYS: dict[type[Message], tuple[Link, Process]] = {
    Admission: (Link.SIM_SERVER, Process.ROBOT_SERVER),
    Supervision: (Link.SIM_SERVER, Process.ROBOT_SERVER),
    Verdict: (Link.HLI_SIM, Process.HLI),
    CommandReply: (Link.HLI_SIM, Process.HLI),
    Request: (Link.HLI_SIM, Process.SIM),
    Command: (Link.HLI_SIM, Process.SIM),
}
"""How a message of the guarded realm goes, and to whom."""


class Wiring:
    """The wires between the services of a cell.

    Args:
        arrive: takes what has arrived, and where.
    """

    def __init__(self, arrive: Callable[[Process, Message], None]) -> None:
        self._arrive = arrive
        self._wires: dict[tuple[Link, Process, str | None, type[Message] | None], MessageWire] = {}
        self._plugged: list[tuple[MessageWire, Process]] = []
        self._links: list[FaultyLink] = []

    def plug(
        self,
        link: Link,
        to: Process,
        wire: MessageWire,
        robots: Iterable[str | None],
        kind: type[Message] | None = None,
    ) -> None:
        """Carry messages on a wire; see `VirtualCell.plug`."""
        self._wires |= {(link, to, robot, kind): wire for robot in robots}
        self._plugged.append((wire, to))
        self._links.append(wire.link)

    def watch(self, links: Iterable[FaultyLink]) -> None:
        """Heed what is under way on links that others pump."""
        self._links += links

    def send(self, now_s: float, link: Link, to: Process, message: Message) -> None:
        """Send a message over a link."""
        robot = getattr(message, "robot", None)
        wire = self._wires.get((link, to, robot, type(message))) or self._wires.get((link, to, robot, None))
        if wire is None or wire.perfect:
            self._arrive(to, message)
        else:
            wire.send(now_s, message)

    @property
    def next_s(self) -> float | None:
        """When the next message arrives, on any link; None if none is under way."""
        return min((due_s for link in self._links if (due_s := link.next_s) is not None), default=None)

    def pump(self, now_s: float) -> None:
        """Carry what arrives by now on the wires that are plugged in."""
        for wire, to in self._plugged:
            for message in wire.take(now_s):
                self._arrive(to, message)
