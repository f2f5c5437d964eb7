"""Start and end of every service process."""

import argparse
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, Never, Self

from deltaq_protocol import log
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError

_log = logging.getLogger(__name__)

AUDIT_FILE = "DELTAQ_AUDIT_FILE"
"""Environment variable: file of the audit log, where no argument names one."""


def arguments(description: str, *, of_robot: bool = False, writes_audit: bool = False) -> argparse.Namespace:
    """Parse a service's command line: `--cell`, `--robot` where there is one process a robot, `--audit` for its log."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--cell", default="lab", help="name or YAML file of the cell (default: lab)")
    if of_robot:
        parser.add_argument("--robot", required=True, help="name of the robot in the cell")
    if writes_audit:
        parser.add_argument(
            "--audit",
            type=Path,
            metavar="FILE",
            default=os.environ.get(AUDIT_FILE) or None,
            help=f"append the audit log to this file of JSON lines (default: {AUDIT_FILE}, or none)",
        )
    return parser.parse_args()


def run(serve: Callable[[], None], service: str) -> None:
    """Run a service until SIGTERM or Ctrl-C; it logs under this name.

    A user's mistake becomes one line and exit status 2; an address that is not available, exit status 3.
    """
    signal.signal(signal.SIGTERM, end_on_interrupt)
    gc.freeze()  # objects loaded by now stay: the collector need not visit them in every cycle
    try:
        log.configure(service)
        serve()
    except (ServiceUnreachableError, OSError) as error:
        _fail(3, error)
    except DeltaqError as error:
        _fail(2, error)
    except KeyboardInterrupt:
        pass


def end_on_interrupt(_signal: int, _frame: FrameType | None) -> Never:
    """Signal handler: end as Ctrl-C does."""
    raise KeyboardInterrupt


class HeldInterrupts:
    """Holds SIGTERM and Ctrl-C back within a block, so that they cut nothing in two.

    Only the main thread is ever interrupted; in any other this does nothing.
    """

    def __init__(self) -> None:
        self._came = False
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGINT):
                self._handlers[number] = signal.signal(number, self._hold)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def let_go(self) -> None:
        """Raise KeyboardInterrupt if one came."""
        if self._came:
            raise KeyboardInterrupt

    def _hold(self, _signal: int, _frame: FrameType | None) -> None:
        self._came = True


def _fail(status: int, error: Exception) -> Never:
    if isinstance(error, log.LogFormatError):
        print(f"error: {error}", file=sys.stderr, flush=True)
    else:
        _log.error("%s", error)
    raise SystemExit(status)
