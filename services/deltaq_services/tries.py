"""Guessing at tokens, kept slow. Plain decisions; the shell passes the time in."""

from __future__ import annotations

from deltaq_services.rate_limit import RateLimit

MOST_TRIES_S = 3.0
"""Wrong tokens a second of one peer; what comes beyond is not compared."""
_MOST_PEERS = 256


class Tries:
    """Wrong tokens, by the address that they came from: only so many of each are compared in a second."""

    def __init__(self) -> None:
        self._rates: dict[str, RateLimit] = {}

    def may_try(self, address: str, time_s: float) -> bool:
        """Whether a token from there is compared at all."""
        return address not in self._rates or self._rates[address].has_left(time_s)

    def failed(self, address: str, time_s: float) -> None:
        """A wrong token came from there."""
        while len(self._rates) >= _MOST_PEERS and address not in self._rates:
            del self._rates[next(iter(self._rates))]
        self._rates.setdefault(address, RateLimit(MOST_TRIES_S)).take(time_s)
