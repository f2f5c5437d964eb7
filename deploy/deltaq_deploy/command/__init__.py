"""The `deltaq` command: verbs by theme, a file each.

Exit status: 0 done, 1 the thing reported is bad, 2 wrong usage or configuration, 3 a service could not be
reached, 130 interrupted before there was a result.
"""

import sys
from typing import NoReturn

from deltaq_deploy.launch import INTERRUPTED, USAGE


def main() -> None:
    """Run the command; neither a user's mistake nor Ctrl-C ends in a traceback.

    All imports that can fail happen in here, since a missing module and an interrupt are reported here.
    """
    try:
        _run()
    except ModuleNotFoundError as error:
        _tell_what_is_missing(error)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception as error:
        if not _is_of_interrupt(error):
            raise
        sys.exit(INTERRUPTED)


def _run() -> None:
    from deltaq_deploy.command.app import app
    from deltaq_deploy.launch.program import run_program

    run_program(lambda: app(prog_name="deltaq"), "deltaq")


def _tell_what_is_missing(error: ModuleNotFoundError) -> NoReturn:
    """Say what to install, unless a module of deltaq itself is missing.

    Raises:
        ModuleNotFoundError: a part of deltaq itself is missing, which no extra provides.
    """
    package = (error.name or "").partition(".")[0]
    if not package or package.startswith("deltaq"):
        raise error
    extra = "testing" if package in ("hypothesis", "pytest") else "all"
    print(
        f"deltaq: {package} is not installed, and this command needs it: pip install 'deltaq[{extra}]'\n"
        "deltaq: `import deltaq` works without it",
        file=sys.stderr,
    )
    sys.exit(USAGE)


def _is_of_interrupt(error: BaseException | None) -> bool:
    """Whether an interrupt caused it: libraries that are being loaded turn one into other errors."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


__all__ = ["main"]
