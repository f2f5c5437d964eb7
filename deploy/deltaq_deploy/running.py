"""A running cell: questions to its HLI, and what it publishes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_protocol import blocking
from deltaq_protocol.blocking import BlockingCell
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.session import open_session
from deltaq_protocol.topics import Topic


class UnknownRobotError(DeltaqError):
    """A robot was named that the cell does not have."""


class OtherCellError(DeltaqError):
    """Another cell is running at the address of the one that was meant."""


def known_robot(cell: CellDescription, robot: str) -> None:
    """Check the name of a robot, before anything is asked about it; an empty one means all of them.

    Raises:
        UnknownRobotError: naming those that the cell has.
    """
    if robot and robot not in cell.robots:
        raise UnknownRobotError(f"no robot {robot!r} in cell {cell.cell}; it has {', '.join(cell.robots)}")


@contextmanager
def connect(cell: CellDescription, client: str, token: str | None = None) -> Iterator[BlockingCell]:
    """A client of the HLI of a running cell.

    Args:
        cell: the description that says where it is.
        client: a name for others to see.
        token: the operator's token, where the HLI was given one.

    Raises:
        ServiceUnreachableError: if no HLI is there.
        OtherCellError: if it serves another cell.
    """
    with blocking.connect(cell.hli, client, token) as running:
        if running.description.cell != cell.cell:
            raise OtherCellError(
                f"{cell.hli} serves cell {running.description.cell}, not {cell.cell}; name the right one with --cell"
            )
        yield running


class Listener:
    """Subscriptions to what an HLI publishes; see `listen`."""

    def __init__(self, session: Any, cell: CellDescription) -> None:
        self._session = session
        self._cell = cell.cell

    def subscribe(self, topic: Topic, handler: Any, robot: str = "") -> Any:
        """Receive samples of a stream, of one robot or of all; `handler` as zenoh takes it."""
        fields = {"robot": robot} if robot else {}
        return self._session.declare_subscriber(topic.key(self._cell, **fields), handler)


@contextmanager
def listen(cell: CellDescription) -> Iterator[Listener]:
    """Listen to the HLI of a running cell.

    Raises:
        ServiceUnreachableError: if nothing listens there.
    """
    session = open_session(connect=[cell.hli], must_connect=True)
    try:
        yield Listener(session, cell)
    finally:
        session.close()
