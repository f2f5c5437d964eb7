"""Limits on connections: of clients, of one peer, and of further connections that may only stop.

Pure. A connection beyond the limits may still stop the cell: it is kept for a moment, and only a stop is read from
it. If too many of them wait, the oldest is closed, so silent ones lock no other out.
"""

from collections.abc import Hashable, Iterator
from itertools import zip_longest
from typing import Generic, TypeVar

from deltaq_cell.open_realm import is_loopback
from deltaq_services.rate_limit import RateLimit

# Places for connections of which nothing is known yet, so that silent ones use nothing up.
#
# Plain decisions. Nobody is refused one, since a stop may be behind each: where there are too many an older
# one gives way, of the address that has the most. To be taken up, or to agree on an encryption, takes
# milliseconds, and a newcomer is the last to give way.

C = TypeVar("C", bound=Hashable)

MAX_WAITING = 256
MAX_WAITING_OF_A_PEER = 64
"""Of one address; on the loopback everybody has the same, and may have all."""


class WaitingPlaces(Generic[C]):
    """Connections that wait, with their addresses, the oldest first."""

    def __init__(self) -> None:
        self._by_address: dict[str, dict[C, None]] = {}
        self._addresses: dict[C, str] = {}

    def __len__(self) -> int:
        """How many there are."""
        return len(self._addresses)

    def __iter__(self) -> Iterator[C]:
        """One of each address in turns, the newest first."""
        for turn in zip_longest(*map(reversed, reversed(self._by_address.values()))):
            yield from (one for one in turn if one is not None)

    def take(self, one: C, address: str) -> C | None:
        """Add a connection; returns the one that must be closed for it, if any."""
        mine = self._by_address.get(address, {})
        if len(mine) >= MAX_WAITING_OF_A_PEER and not is_loopback(address):
            gives_way = next(iter(mine))
        elif len(self) >= MAX_WAITING:
            most: dict[C, None] = max(self._by_address.values(), key=len)
            gives_way = next(iter(most))
        else:
            gives_way = None
        if gives_way is not None:
            self.leave(gives_way)
        self._by_address.setdefault(address, {})[one] = None
        self._addresses[one] = address
        return gives_way

    def leave(self, one: C) -> None:
        """Remove a connection."""
        address = self._addresses.pop(one, None)
        if address is not None:
            del self._by_address[address][one]
            if not self._by_address[address]:
                del self._by_address[address]


# The order in which waiting lines are served. Pure: the shell passes the time.
#
# Connections that hold a lease come first, since a robot waits for them; the others follow in turn, one
# line each. Every connection has a rate, and those without a lease share one, so time is left for the robots' states
# however many they are. A line beyond a rate is not lost: it waits, and only its sender waits.

MOST_LINES_S = 2000.0
"""Lines a second of one connection: several times the need for two robots at 4 ms."""
MOST_TOGETHER_S = 2000.0
"""Lines a second of all connections together that hold no lease."""


class LineTurns(Generic[C]):
    """The connections with a waiting line, and the rate of each.

    Args:
        most_lines_s: lines a second of one connection.
    """

    def __init__(self, most_lines_s: float = MOST_LINES_S) -> None:
        self._most_lines_s = most_lines_s
        self._together = RateLimit(MOST_TOGETHER_S)
        self._rates: dict[C, RateLimit] = {}
        # dictionaries as queues: each connection once, the one that waits longest first
        self._holders: dict[C, None] = {}
        self._others: dict[C, None] = {}

    def __bool__(self) -> bool:
        """Whether a line waits."""
        return bool(self._holders or self._others)

    def wait(self, connection: C, is_holder: bool) -> None:
        """Note that a connection has a waiting line."""
        mine, other = (self._holders, self._others) if is_holder else (self._others, self._holders)
        other.pop(connection, None)
        mine.setdefault(connection)

    def leave(self, connection: C) -> None:
        """Note that a connection has ended."""
        self._holders.pop(connection, None)
        self._others.pop(connection, None)
        self._rates.pop(connection, None)

    def next(self, time_s: float) -> C | None:
        """The connection whose line is served now; None if the rates allow none yet.

        It waits again only after `wait`.
        """
        for connection in self._holders:
            if self._rate(connection).take(time_s):
                del self._holders[connection]
                return connection
        for connection in self._others:
            if self._rate(connection).take(time_s):
                if not self._together.take(time_s):
                    return None
                del self._others[connection]
                return connection
        return None

    def _rate(self, connection: C) -> RateLimit:
        return self._rates.setdefault(connection, RateLimit(self._most_lines_s))


MAX_CONNECTIONS = 64
MAX_OF_A_PEER = 16
"""Of one address; on the loopback everybody has the same, and may have all."""
MAX_STOP_PLACES = 256


class Places(Generic[C]):
    """The connected clients, with their addresses."""

    def __init__(self) -> None:
        self.clients: dict[C, str] = {}
        self._for_stops: dict[C, None] = {}

    def take(self, connection: C, address: str) -> bool:
        """Count a connection as a client; returns False if the limit is reached."""
        mine = sum(taken == address for taken in self.clients.values())
        if len(self.clients) >= MAX_CONNECTIONS or (mine >= MAX_OF_A_PEER and not is_loopback(address)):
            return False
        self.clients[connection] = address
        return True

    def keep_for_stop(self, connection: C) -> C | None:
        """Keep a connection for a stop alone; returns the one that must be closed for it, if any."""
        self._for_stops[connection] = None
        oldest = next(iter(self._for_stops)) if len(self._for_stops) > MAX_STOP_PLACES else None
        if oldest is not None:
            del self._for_stops[oldest]
        return oldest

    def leave(self, connection: C) -> bool:
        """Remove a connection; returns whether it was a client's."""
        self._for_stops.pop(connection, None)
        return self.clients.pop(connection, None) is not None
