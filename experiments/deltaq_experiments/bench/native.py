"""References in C, compiled for the run."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from deltaq_protocol.errors import DeltaqError

_HERE = Path(__file__).parent


class CompilerError(DeltaqError):
    """There is no C compiler, or it failed."""


def program(name: str, folder: Path) -> str:
    """The program of `NAME.c` of this folder, made by the compiler that CC names, or by `cc`.

    Args:
        name: of the program.
        folder: for the executable.

    Raises:
        CompilerError: if there is no compiler, or it cannot compile it.
    """
    compiler = os.environ.get("CC") or "cc"
    found = shutil.which(compiler)
    if found is None:
        raise CompilerError(
            f"the reference is a C program, and there is no compiler {compiler!r}: install one, or name it in CC"
        )
    made = folder / name
    command = [found, "-std=gnu11", "-O2", "-o", str(made), str(_HERE / f"{name}.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise CompilerError(f"{' '.join(command)} failed:\n{done.stderr.strip()}")
    return str(made)
