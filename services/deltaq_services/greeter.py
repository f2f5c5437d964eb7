"""Greets those who send what is not made for this process, so that they bind to it what they send next."""

from __future__ import annotations

from collections.abc import Callable

from deltaq_protocol.guarded import Greeting
from deltaq_services.rate_limit import Pace

_PERIOD_S = 0.01
"""Whoever sends again what was recorded shall not make a service speak without end."""


class Greeter:
    """One service's greetings, at most one in so often.

    Args:
        service: name of the service that greets.
        publish: sends one.
    """

    def __init__(self, service: str, publish: Callable[[Greeting], None]) -> None:
        self._greeting = Greeting(service=service)
        self._publish = publish
        self._pace = Pace(_PERIOD_S)

    def greet(self, time_s: float) -> None:
        """Somebody does not know this process."""
        if self._pace.due(time_s):
            self._publish(self._greeting)
