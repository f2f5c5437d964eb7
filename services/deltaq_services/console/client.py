"""One browser, as the core knows it."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

from deltaq_services.console.clock_offset import ClockOffset
from deltaq_services.console.commands import MOST_MESSAGES_S
from deltaq_services.console.messages import Ack
from deltaq_services.rate_limit import RateLimit

_LONGEST_NAME = 64
"""Of a client, in a message to the HLI."""
_ANSWERS_KEPT = 256
"""Newest answers that are given again to a command that comes twice."""


@dataclass
class Client:
    """One browser.

    Attributes:
        number: of its connection, different from every other.
        name: by which others see it.
        is_operator: it may command; one that may not looks, and stops.
        address: it connects from.
        clocks: its clock against this one.
        rate: bounds the rate of its messages.
        shows_replay: it shows a recording, and commands nothing but a stop.
        session: by which its page is known again when it is loaded anew; empty for none.
        page: tells the page of this session from one that was loaded before or beside it.
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
    _answers: OrderedDict[str, Ack] = field(default_factory=OrderedDict)

    @property
    def in_the_audit_log(self) -> str:
        """The name that the HLI gets for the sender: `console`, and the name that the browser gave itself."""
        return f"console: {self.name} at {self.address or 'no address'}"[:_LONGEST_NAME]

    def answered(self, command_id: str) -> Ack | None:
        """The newest answer to a command that came before; None if it did not."""
        return self._answers.get(command_id)

    def answer(self, ack: Ack) -> Ack:
        """Keep an answer, for the case that its command comes again; returns it."""
        if not ack.id:
            return ack
        self._answers[ack.id] = ack
        self._answers.move_to_end(ack.id)
        while len(self._answers) > _ANSWERS_KEPT:
            self._answers.popitem(last=False)
        return ack
