"""Who comes in at the console's door: an operator, an observer, or nobody.

Plain decisions; the shell passes the time in.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum, auto

from deltaq_services.console.settings import Settings
from deltaq_services.rate_limit import Tries


class Entrance(Enum):
    """The role that a token gives."""

    OPERATOR = auto()
    OBSERVER = auto()
    WRONG = auto()
    """It was compared, and is not the console's."""
    NOT_COMPARED = auto()
    """Too many wrong ones came from there: no more are looked at for a moment."""


class Door:
    """Looks at tokens, and not at many wrong ones of an address.

    Args:
        settings: have the console's token.
        counters: count tokens that were wrong, and those that were not compared.
    """

    def __init__(self, settings: Settings, counters: Counter[str]) -> None:
        self._settings = settings
        self._counters = counters
        self._tries = Tries()

    def look(self, token: str, address: str, time_s: float) -> Entrance:
        """The role that a token from an address gives; an empty token is none."""
        if not token:
            return Entrance.OBSERVER if self._settings.token_needed else Entrance.OPERATOR
        if not self._tries.may_try(address, time_s):
            self._counters["tokens_not_compared"] += 1
            return Entrance.NOT_COMPARED
        if self._settings.is_operator(token):
            return Entrance.OPERATOR
        self._tries.failed(address, time_s)
        self._counters["tokens_wrong"] += 1
        return Entrance.WRONG
