"""Places for connections of which nothing is known yet, so that silent ones use nothing up.

Plain decisions. Nobody is refused one, since a stop may be behind each: where there are too many an older one gives
way, of the address that has the most. To be taken up, or to agree on an encryption, takes milliseconds, and a newcomer
is the last to give way.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from typing import Generic, TypeVar

from deltaq_cell.open_realm import is_loopback

C = TypeVar("C")

MAX_WAITING = 256
MAX_WAITING_OF_A_PEER = 64
"""Of one address; on the loopback everybody has the same, and may have all."""


class WaitingPlaces(Generic[C]):
    """Who waits, from where, the oldest first."""

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
        """Give one a place; returns the one that gives way for it, if one must."""
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
        """One waits no longer."""
        address = self._addresses.pop(one, None)
        if address is not None:
            del self._by_address[address][one]
            if not self._by_address[address]:
                del self._by_address[address]
