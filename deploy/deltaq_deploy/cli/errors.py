"""Exit status of an error, and how it is told."""

from __future__ import annotations

import sys

from deltaq_deploy.launcher import LaunchError, LaunchInterruptedError
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError

DONE = 0
BAD = 1
USAGE = 2
UNREACHABLE = 3


def exit_status(error: DeltaqError) -> int:
    """1 if something was refused or broke, 3 if nobody answered, 2 for what the caller can put right."""
    if isinstance(error, ServiceUnreachableError):
        return UNREACHABLE
    if isinstance(error, RefusedError | LaunchError | LaunchInterruptedError):
        return BAD
    return USAGE


def report(error: DeltaqError) -> None:
    """Tell an error on standard error."""
    print(f"deltaq: {error}", file=sys.stderr)
