"""Places for connections: so many for clients, so many of one peer, and others that are kept for a stop.

Plain decisions. Whoever finds no place may still stop the cell: such a connection is kept for a moment, and nothing but
a stop is read from it. When too many of them wait the oldest gives way, so that silent ones keep nobody out.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Generic, TypeVar

from deltaq_cell.open_realm import is_loopback

C = TypeVar("C")

MAX_CONNECTIONS = 64
MAX_OF_A_PEER = 16
"""Of one address; on the loopback everybody has the same, and may have all."""
MAX_STOP_PLACES = 256


class Place(Enum):
    """What a connection gets."""

    CLIENT = auto()
    STOP_ALONE = auto()


class Places(Generic[C]):
    """Who is connected, from where."""

    def __init__(self) -> None:
        self.clients: dict[C, str] = {}
        self._for_stops: dict[C, None] = {}

    def take(self, connection: C, address: str) -> tuple[Place, C | None]:
        """Give a connection its place; also returns the one that gives way for it, if one must."""
        mine = sum(taken == address for taken in self.clients.values())
        if len(self.clients) < MAX_CONNECTIONS and (mine < MAX_OF_A_PEER or is_loopback(address)):
            self.clients[connection] = address
            return Place.CLIENT, None
        return Place.STOP_ALONE, self.take_for_stop(connection)

    def take_for_stop(self, connection: C) -> C | None:
        """Give a connection a place for a stop alone; returns the one that gives way for it, if one must."""
        self._for_stops[connection] = None
        oldest = next(iter(self._for_stops)) if len(self._for_stops) > MAX_STOP_PLACES else None
        if oldest is not None:
            del self._for_stops[oldest]
        return oldest

    def leave(self, connection: C) -> bool:
        """A connection has ended; whether it was a client's."""
        self._for_stops.pop(connection, None)
        return self.clients.pop(connection, None) is not None
