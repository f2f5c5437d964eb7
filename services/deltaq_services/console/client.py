"""One browser in the core, and the age of its messages, independent of its clock's time.

A message says when it was sent on its sender's clock. The difference to the time of its arrival is the clocks'
offset plus the delay; the least difference of the last seconds is the offset plus the shortest delay. A message is
late by the rest of its difference. Neither an offset of an hour nor a slow drift of the clocks matters.

The least difference is kept by the second. Seconds in which the connection stalls bring no message and do not count,
so a burst after a stall is compared with the time before it.
"""

from collections import deque
from dataclasses import dataclass, field

from deltaq_services.console.commands import MOST_MESSAGES_S
from deltaq_services.rate_limit import RateLimit

SECONDS_KEPT = 10
"""Seconds with messages over which the least difference is taken: after these, a clock that was set is believed."""


_LONGEST_NAME = 64
"""Of a client, in a message to the HLI."""


class ClockOffset:
    """Of one connection."""

    def __init__(self) -> None:
        self._least: deque[tuple[int, float]] = deque(maxlen=SECONDS_KEPT)

    def hear(self, sent_s: float, arrived_s: float) -> float:
        """Take a message; returns its lateness [s], 0 for the first.

        Args:
            sent_s: on the sender's clock [s].
            arrived_s: on this clock [s].
        """
        difference, second = arrived_s - sent_s, int(arrived_s)
        if self._least and self._least[-1][0] == second:
            self._least[-1] = (second, min(self._least[-1][1], difference))
        else:
            self._least.append((second, difference))
        return difference - min(least for _, least in self._least)


@dataclass
class Client:
    """One browser.

    Attributes:
        number: of its connection, different from every other.
        name: its name for others.
        is_operator: whether it may command; other clients may only look and stop.
        address: it connects from.
        clocks: its clock against this one.
        rate: bounds the rate of its messages.
        shows_replay: it shows a recording, and commands nothing but a stop.
        session: identifies its page after a reload; empty for none.
        page: distinguishes this page from others of the same session.
        given_name: the name that it gave itself.
    """

    number: int
    name: str
    is_operator: bool
    address: str = ""
    clocks: ClockOffset = field(default_factory=ClockOffset)
    rate: RateLimit = field(default_factory=lambda: RateLimit(MOST_MESSAGES_S))
    shows_replay: bool = False
    session: str = ""
    page: str = ""
    given_name: str = ""

    @property
    def in_the_audit_log(self) -> str:
        """The name that the HLI gets for the sender: `console`, and the name that the browser gave itself."""
        return f"console: {self.name} at {self.address or 'no address'}"[:_LONGEST_NAME]
