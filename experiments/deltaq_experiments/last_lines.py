"""What services printed last, to be shown if a run fails."""

from __future__ import annotations

import threading
from collections import deque

KEPT = 20
"""Lines that are kept."""


class LastLines:
    """Keeps the last lines of all services; any thread may add one."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=KEPT)
        self._lock = threading.Lock()

    def __call__(self, name: str, line: str) -> None:
        """Keep a line of a service."""
        with self._lock:
            self._lines.append(f"{name}: {line}")

    def text(self) -> str:
        """The lines, oldest first."""
        with self._lock:
            return "\n".join(self._lines)
