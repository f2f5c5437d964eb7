"""A flood over zenoh waits at its sender's: the thread that reads its session pauses, and that of no other."""

from __future__ import annotations

import os
import threading
import time

from deltaq_protocol.session import MAX_SESSIONS
from deltaq_services.rate_limit import RateLimit

_WAIT_S = 0.004
"""What a session waits for each message beyond the rate."""


_OWN_SESSIONS = 16
"""To the SIM and the Robot Servers."""


def give_each_session_a_thread() -> None:
    """Have zenoh read each session in a thread of its own; before the first one is opened, or it has no effect."""
    threads = MAX_SESSIONS + _OWN_SESSIONS
    os.environ.setdefault("ZENOH_RUNTIME", f"(rx: (worker_threads: {threads}))")


class FloodWait:
    """Lets messages of strangers pass at a rate; zenoh's threads ask, one for each session.

    Args:
        most_s: messages a second that nobody waits for, of all sessions together, and the most at once.
    """

    def __init__(self, most_s: float) -> None:
        self._rate = RateLimit(most_s)
        self._lock = threading.Lock()

    def one_more(self) -> None:
        """A message has come; returns when the next one of its session may be read."""
        with self._lock:
            is_flood = not self._rate.take(time.monotonic())
        if is_flood:
            time.sleep(_WAIT_S)
