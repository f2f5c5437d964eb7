"""How many cycles without a valid reply a controller permits, by the rule of its generation.

| rule | what counts | exceeded when |
| --- | --- | --- |
| `consecutive` | late cycles since the last valid reply | more than the budget |
| `total` | late cycles since RSI_ON | more than the budget |
| `share` | late cycles among the last 1000 telegrams | more than so many percent of 1000 |

KR C4 and later permit a number of cycles (Timeout of the ETHERNET object); whether in a row or altogether is not known.
A KR C2 permits a fraction (maxLatePackages) of a window of 1000 telegrams; those not sent yet count as answered.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

from deltaq_emulator.catalogue import Code, KrcMessage

LateRule = Literal["consecutive", "total", "share"]

FIELD_OF_VIEW = 1000
"""Telegrams among which a KR C2 counts the late ones."""


class LateBudget:
    """Counts late cycles.

    Args:
        rule: which of them count.
        cycles: permitted, where cycles are counted.
        percent: of the window permitted, where a fraction is counted.
    """

    def __init__(self, rule: LateRule, cycles: int, percent: float) -> None:
        self._rule = rule
        self._cycles = cycles
        self._percent = percent
        self.begin_session()

    def begin_session(self) -> None:
        """Count from zero."""
        self._view: deque[bool] = deque(maxlen=FIELD_OF_VIEW)
        self.counted = 0
        """Late cycles that count now."""

    def cycle(self, late: bool) -> None:
        """A cycle passed with or without a valid reply."""
        if self._rule == "consecutive" and not late:
            self.counted = 0
        if self._rule == "share":
            leaving = len(self._view) == FIELD_OF_VIEW and self._view[0]
            self._view.append(late)
            self.counted -= leaving
        self.counted += late

    @property
    def exceeded(self) -> KrcMessage | None:
        """The message if more are late than permitted."""
        if self._rule == "share":
            percent = 100.0 * self.counted / FIELD_OF_VIEW
            if percent > self._percent:
                return KrcMessage(Code.LATE_SHARE, "", percent, self._percent)
        elif self.counted > self._cycles:
            return KrcMessage(Code.LATE_PACKETS, "", self.counted, self._cycles)
        return None
