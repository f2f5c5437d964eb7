"""GNU Octave, where it is installed, with the MATLAB client on its path."""

import functools
import os
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path

MATLAB = Path(__file__).parents[2] / "clients" / "matlab"


@functools.cache
def why_no_octave() -> str:
    """Why Octave cannot run the client here; empty if it can."""
    if shutil.which("octave-cli") is None:
        return "GNU Octave is not installed (on Debian: apt install octave octave-instrument-control)"
    loaded = subprocess.run(
        command("pkg load instrument-control"), env=environment(), capture_output=True, text=True, check=False
    )
    if loaded.returncode:
        return "Octave has no package instrument-control (on Debian: apt install octave-instrument-control)"
    return ""


def command(program: str) -> list[str]:
    """Runs a program with the client and its examples on the path; an error of it is the last line told."""
    path = f"addpath('{MATLAB}', '{MATLAB / 'examples'}'); "
    return ["octave-cli", "--norc", "--no-history", "--quiet", "--eval", path + program]


def run(program: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a program until it ends, where that is allowed ahead of all ordinary programs: others run here, too."""
    with subprocess.Popen(
        command(program),
        env=environment(**variables),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        try:
            with suppress(PermissionError):
                os.sched_setscheduler(running.pid, os.SCHED_FIFO, os.sched_param(1))
            told, errors = running.communicate()
        except BaseException:
            running.kill()
            raise
    return subprocess.CompletedProcess(running.args, running.returncode, told, errors)


def environment(**variables: str) -> dict[str, str]:
    """Without a token that the tests' own environment may have, and with one thread."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DELTAQ_")}
    return {**kept, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **variables}
