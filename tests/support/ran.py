"""Programs in processes of their own, with what they print."""

import subprocess
from collections.abc import Sequence
from typing import Any


def ran(command: Sequence[str], check: bool = True, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a command and wait for its end.

    Args:
        command: program and arguments.
        check: whether an exit status other than 0 is an error.
        options: of `subprocess.run`.
    """
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200, **options)
    assert not check or done.returncode == 0, done.stderr
    return done
