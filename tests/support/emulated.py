"""An emulated KRC as a process."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PATIENCE_S = 300.0


@contextmanager
def emulator(cell: Path, robot: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "deltaq_emulator", "--cell", str(cell), "--robot", robot]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
