"""A heartbeat to the supervisor of this process: a file for a container's health check, and systemd's socket.

The loop that does a service's work writes it, so a loop that hangs is found. Reading it needs no session, no key and
no interpreter. `deltaq status --service` asks a service over the network instead, as its clients do.
"""

import contextlib
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deltaq_protocol.errors import DeltaqError

HEALTH_FILE = "DELTAQ_HEALTH_FILE"
"""Environment variable: file in memory (tmpfs) whose one line is `healthy` or `unhealthy`, the time since boot [s],
and a detail in words.
"""
NOTIFY_SOCKET = "NOTIFY_SOCKET"
"""Environment variable of systemd with the socket that gets the service's readiness and its heartbeats."""
PERIOD_S = 1.0
_LINE_BYTES = 256
"""Every line is as long, so that one is written over another in one step."""


class Heartbeat:
    """Heartbeats for a supervisor, at most one a second; without a supervisor they cost a comparison.

    Args:
        environment: its variables name the supervisor.

    Raises:
        DeltaqError: if the health file cannot be written.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._file = _opened(environment.get(HEALTH_FILE))
        self._supervisor = _connected(environment.get(NOTIFY_SOCKET))
        self._next_s = 0.0 if self._file is not None or self._supervisor is not None else float("inf")
        self._greeting = b"READY=1\n"

    def is_due(self, time_s: float) -> bool:
        """Whether a heartbeat is due at this monotonic time [s]."""
        return time_s >= self._next_s

    def beat(self, time_s: float, healthy: bool = True, detail: str = "") -> None:
        """Write a heartbeat if one is due; a failed one is not repeated.

        Args:
            time_s: monotonic time [s].
            healthy: whether the service can do its work.
            detail: in words.
        """
        if not self.is_due(time_s):
            return
        self._next_s = time_s + PERIOD_S
        said = detail.translate(_NO_LINES)
        if self._file is not None:
            second = int(time.clock_gettime(time.CLOCK_BOOTTIME))
            line = f"{'healthy' if healthy else 'unhealthy'} {second} {said}".encode(errors="replace")
            with contextlib.suppress(OSError):
                os.pwrite(self._file, line[: _LINE_BYTES - 1].ljust(_LINE_BYTES - 1) + b"\n", 0)
        if self._supervisor is not None:
            with contextlib.suppress(OSError):
                self._supervisor.send(
                    self._greeting + f"WATCHDOG=1\nSTATUS={said}\n".encode(errors="replace")
                )
                self._greeting = b""

    def close(self) -> None:
        """Give no more."""
        self._next_s = float("inf")
        if self._file is not None:
            os.close(self._file)
            self._file = None
        if self._supervisor is not None:
            self._supervisor.close()
            self._supervisor = None


_NO_LINES: dict[int, Any] = dict.fromkeys((*range(32), 0x85, 0x2028, 0x2029), " ")


def _opened(file: str | None) -> int | None:
    if not file:
        return None
    try:
        return os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise DeltaqError(f"{HEALTH_FILE}: {Path(file)} cannot be written: {error.strerror}") from error


def _connected(address: str | None) -> socket.socket | None:
    if not address:
        return None
    supervisor = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    supervisor.setblocking(False)
    try:
        # systemd names a socket without a file by an @, which stands for a zero byte
        supervisor.connect("\0" + address[1:] if address.startswith("@") else address)
    except OSError:  # the supervisor that set the variable has ended, or never listened
        supervisor.close()
        return None
    return supervisor
