"""Exit status of an error, and its message."""

from __future__ import annotations

import sys

from deltaq_command import INTERRUPTED, USAGE
from deltaq_launch.errors import LaunchError, LaunchInterruptedError
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError

DONE = 0
BAD = 1
UNREACHABLE = 3


def exit_status(error: DeltaqError) -> int:
    """1 if something was refused or broke, 3 if nobody answered, 130 if interrupted, 2 if the caller can help it."""
    if isinstance(error, ServiceUnreachableError):
        return UNREACHABLE
    if isinstance(error, LaunchInterruptedError):
        return INTERRUPTED
    if isinstance(error, RefusedError | LaunchError):
        return BAD
    return USAGE


def report(error: DeltaqError) -> None:
    """Print an error on standard error."""
    print(f"deltaq: {error}", file=sys.stderr)
