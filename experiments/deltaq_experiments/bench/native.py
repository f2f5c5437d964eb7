"""References in C, compiled where there is a compiler; else the same in Python."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from deltaq_protocol.errors import DeltaqError

_HERE = Path(__file__).parent


class CompilerError(DeltaqError):
    """A C compiler that is there, and fails."""


@dataclass(frozen=True)
class NativeProgram:
    """A program to be run.

    Attributes:
        command: it and the arguments that it always has.
        language: that it is written in, for people.
    """

    command: tuple[str, ...]
    language: str


def program(name: str, folder: Path, compiler: str | None = None) -> NativeProgram:
    """`NAME.c` of this folder, or `NAME.py` where there is no compiler.

    Args:
        name: of the program.
        folder: for what is compiled.
        compiler: to be used; None for the one that CC names, or `cc`.

    Raises:
        CompilerError: if the compiler cannot compile it.
    """
    found = shutil.which(compiler or os.environ.get("CC") or "cc")
    if found is None:
        return NativeProgram((sys.executable, "-m", f"{__package__}.{name}"), "Python")
    made = folder / name
    command = [found, "-std=gnu11", "-O2", "-o", str(made), str(_HERE / f"{name}.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise CompilerError(f"{' '.join(command)} failed:\n{done.stderr.strip()}")
    return NativeProgram((str(made),), "C")
