"""How a program ends: without a traceback for a user's mistake, for Ctrl-C, or for a reader that has left."""

import os
import sys
from collections.abc import Callable
from typing import NoReturn

from deltaq_deploy.launch import BAD, DONE, INTERRUPTED, UNREACHABLE, USAGE
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError


class LaunchError(DeltaqError):
    """A service could not be started, or ended before it served."""


class LaunchInterruptedError(DeltaqError):
    """A signal arrived while services were still starting."""


def exit_status(error: DeltaqError) -> int:
    """1 if something was refused or failed, 2 for wrong usage, 3 if no service answered, 130 if interrupted."""
    if isinstance(error, ServiceUnreachableError):
        return UNREACHABLE
    if isinstance(error, LaunchInterruptedError):
        return INTERRUPTED
    if isinstance(error, RefusedError | LaunchError):
        return BAD
    return USAGE


def run_program(main: Callable[[], int | None], name: str) -> NoReturn:
    """Run a program and end with its exit status.

    Args:
        main: the program; returns its exit status, or None where it is done.
        name: precedes the error's message on standard error.
    """
    try:
        sys.exit(_run_and_flush(main))
    except DeltaqError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(exit_status(error))
    except BrokenPipeError:
        # the reader of the output (`| head`) has gone; the interpreter would flush once more as it ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(DONE)
    except (OSError, MemoryError) as error:  # a full disk, too few descriptors, no memory
        print(f"{name}: {error or 'no memory is left'}", file=sys.stderr)
        sys.exit(BAD)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _run_and_flush(main: Callable[[], int | None]) -> int | str | None:
    """The exit status, once all that was printed is written: until then the reader may be found to have left."""
    status: int | str | None
    try:
        status = main()
    except SystemExit as end:
        status = end.code
    sys.stdout.flush()
    return status
