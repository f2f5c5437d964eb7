"""The `deltaq` command: one small file a verb.

Exit status: 0 done, 1 the thing reported is bad, 2 wrong usage or configuration, 3 a service could not be
reached.
"""

from __future__ import annotations

import sys

from deltaq_deploy.cli.app import app
from deltaq_deploy.cli.errors import exit_status, report
from deltaq_protocol.errors import DeltaqError


def main() -> None:
    """Run the command; a user's mistake ends in one clear line, never in a traceback."""
    try:
        app(prog_name="deltaq")
    except DeltaqError as error:
        report(error)
        sys.exit(exit_status(error))
    except BrokenPipeError:
        # the reader of our output (`| head`) has left; nothing more can be said
        sys.stderr.close()
        sys.exit(0)


__all__ = ["app", "main"]
