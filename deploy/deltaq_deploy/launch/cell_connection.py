"""A running cell: queries to its HLI, and its streams."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_protocol import blocking
from deltaq_protocol.blocking import BlockingCell
from deltaq_protocol.certified.encryption import client_tls
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.identity import CellIdentity, mismatch
from deltaq_protocol.messages import Description
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Topic


@dataclass(frozen=True)
class Where:
    """The address of a running cell.

    Attributes:
        hli: address of its HLI.
        cell: the name that it must have; None: any cell.
        robot: a robot that it must have, if it is not empty.
    """

    hli: str
    cell: str | None = None
    robot: str = ""

    @classmethod
    def of(cls, cell: str, url: str | None, robot: str = "") -> Where:
        """From a user's options; `cell` is ignored if an address is given.

        Args:
            cell: name of a shipped cell or path of a file.
            url: address of the HLI, or None.
            robot: a robot that it must have.

        Raises:
            InvalidEndpointError: `url` is no address.
            CellError: `cell` cannot be read.
            DeltaqError: the cell has no such robot.
        """
        if url is not None:
            return cls(str(Endpoint.parse(url)), robot=robot)
        from deltaq_cell.load import load_cell

        description = load_cell(cell)
        known_robot(description, robot)
        return cls(description.hli, description.cell, robot)


def known_robot(cell: CellDescription | Description, robot: str) -> None:
    """Check the name of a robot, before anything is asked about it; an empty one means all of them.

    Raises:
        DeltaqError: naming those that the cell has.
    """
    if robot and robot not in cell.robots:
        raise DeltaqError(f"no robot {robot!r} in cell {cell.cell}; it has {', '.join(cell.robots)}")


@contextmanager
def connect(cell: CellDescription | Where, client: str, token: str | None = None) -> Iterator[BlockingCell]:
    """A client of the HLI of a running cell.

    Args:
        cell: where it is; a whole description is compared with that of the running cell.
        client: a name for others to see.
        token: the operator's token, where the HLI was given one.

    Raises:
        ServiceUnreachableError: if no HLI is there.
        DeltaqError: if it serves another cell, or has read another description of it, or it has no such robot.
    """
    with blocking.connect(cell.hli, client, token) as running:
        check_same(cell, running.description)
        yield running


def check_same(cell: CellDescription | Where, running: Description) -> None:
    """Check that the cell that runs is the one that is meant.

    Raises:
        DeltaqError: it is another cell, or has read another description of it, or it has no such robot.
    """
    if cell.cell is not None and running.cell != cell.cell:
        raise DeltaqError(
            f"{cell.hli} serves cell {running.cell}, not {cell.cell}; name the right one with --cell"
        )
    if isinstance(cell, CellDescription):
        _compare(cell, running)
    else:
        known_robot(running, cell.robot)


def _compare(cell: CellDescription, running: Description) -> None:
    from deltaq_cell.identity import content_identity

    ours, theirs = content_identity(cell), CellIdentity.parse(running.identity)
    if not ours.is_same(theirs):
        said = mismatch(f"the HLI at {cell.hli}", theirs, ours)
        raise DeltaqError(
            f"{said}; restart the cell if its file has changed, or name the right one with --cell"
        )


class Listener:
    """Subscriptions to an HLI's streams; see `listen`."""

    def __init__(self, session: Any, cell: str) -> None:
        self._session = session
        self._cell = cell

    def subscribe(self, topic: Topic, handler: Any, robot: str = "") -> Any:
        """Receive samples of a stream, of one robot or of all; `handler` as zenoh takes it."""
        fields = {"robot": robot} if robot else {}
        return self._session.declare_subscriber(topic.key(self._cell, **fields), handler)


def describe(where: Where, client: str) -> Description:
    """The description of a running cell, from its HLI.

    Raises:
        ServiceUnreachableError: if no HLI is there.
        DeltaqError: if it serves another cell.
    """
    with connect(where, client) as running:
        return running.description


def described(cell: str, url: str | None, client: str) -> CellDescription:
    """The description of a cell: from its file, or, if an address is given, from the HLI there.

    Raises:
        CellError: the file cannot be read.
        ServiceUnreachableError: if no HLI is at the address.
    """
    from deltaq_cell.load import load_cell, parse_cell

    if url is None:
        return load_cell(cell)
    where = Where.of(cell, url)
    told = describe(where, client)
    return parse_cell(told.yaml, told.cell).model_copy(update={"hli": where.hli})


@contextmanager
def listen(cell: CellDescription | Where) -> Iterator[Listener]:
    """Listen to the HLI of a running cell.

    Raises:
        ServiceUnreachableError: if nothing listens there.
    """
    with open_session(connect=[cell.hli], must_connect=True, tls=client_tls(cell.hli)) as session:
        yield Listener(session, cell.cell or "*")
