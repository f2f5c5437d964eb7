"""Clocks of single processes that can be set while they run, the system's clock untouched.

A small C library (`clocks.c`), compiled when it is needed, is preloaded into the processes. It adds an offset to
their clocks, and subtracts it from deadlines that go to the kernel.
"""

import mmap
import os
import shutil
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from deltaq_protocol.errors import DeltaqError

_SOURCE = Path(__file__).with_name("clocks.c")
_LAYOUT = struct.Struct("=4q")  # `struct clocks` of the source
_NS = 1_000_000_000


class NoCompilerError(DeltaqError):
    """The C library that sets clocks cannot be made."""


@dataclass(frozen=True)
class Clocks:
    """What the clocks of one process say beside the system's.

    Attributes:
        wall_s: how far the wall clock, which tells the time of day, is ahead.
        monotonic_s: how far the monotonic clock is ahead, by which programs measure how long things take.
        wall_drift_ppm: by how many millionths the wall clock runs too fast from now on.
    """

    wall_s: float = 0.0
    monotonic_s: float = 0.0
    wall_drift_ppm: int = 0


class SettableClocks:
    """The library, and the clocks of the processes that were started with it.

    Args:
        folder: for the library, and for a file a process.

    Raises:
        NoCompilerError: if there is no C compiler, or it fails.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._library = _compiled(folder)
        self.begin_with(Clocks())

    @property
    def python(self) -> tuple[str, ...]:
        """The command that runs this Python with clocks that can be set; it becomes the process, its id included."""
        settings = (f"LD_PRELOAD={self._library}", f"DELTAQ_CLOCKS={self._folder}")
        return ("env", *settings, sys.executable)

    def set(self, pid: int, clocks: Clocks) -> None:
        """Let the clocks of a process say this from now on."""
        with (self._folder / str(pid)).open("r+b") as file, mmap.mmap(file.fileno(), _LAYOUT.size) as shared:
            shared[:] = _packed(clocks)

    def begin_with(self, clocks: Clocks) -> None:
        """Set the clocks of processes that are started later."""
        (self._folder / "begin").write_bytes(_packed(clocks))


def _packed(clocks: Clocks) -> bytes:
    wall_ns, monotonic_ns = round(clocks.wall_s * _NS), round(clocks.monotonic_s * _NS)
    return _LAYOUT.pack(wall_ns, monotonic_ns, clocks.wall_drift_ppm, time.monotonic_ns())


def _compiled(folder: Path) -> Path:
    compiler = os.environ.get("CC") or "cc"
    if shutil.which(compiler) is None:
        raise NoCompilerError(
            f"no C compiler {compiler!r}, and without one no clock can be set; install gcc or clang, name yours in CC, "
            "or leave out the faults of clocks"
        )
    library = folder / "clocks.so"
    command = [compiler, "-std=gnu11", "-O2", "-shared", "-fPIC", "-o", str(library), str(_SOURCE), "-ldl"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise NoCompilerError(f"{' '.join(command)} failed:\n{done.stderr.strip()}")
    return library
