"""The file of the audit log: whole lines, appended, bounded in size, written in a thread of its own.

Each line is one `write` at the end of the file, so that a process that is killed leaves no half of an earlier line.
What a full disk or a loss of power tore is ended when the next line comes. A killed process loses what its thread
had not written yet; a machine that loses its power, what came since the last `fdatasync`, about a second.
"""

from __future__ import annotations

import itertools
import os
import queue
import stat
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from deltaq_protocol.errors import DeltaqError

MOST_BYTES = 16 * 1024 * 1024
"""Of one file; then it becomes FILE.1, and that FILE.2."""
MOST_FILES = 8
MOST_WAITING = 4096
"""Lines that may wait for a slow disk."""
_SYNC_PERIOD_S = 1.0
_CLOSE_DEADLINE_S = 2.0
"""Time for a slow disk when the service ends."""
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class AuditFileError(DeltaqError):
    """A file that cannot hold the audit log."""


class AuditFile:
    """Appends lines.

    Args:
        path: path of the file; its folder must exist. A new file has mode 0600.
        most_bytes: largest size of one file [bytes].
        most_files: number of files that are kept, including the one that is being written.

    Raises:
        AuditFileError: the file cannot be opened for writing, or others may read it.
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES, most_files: int = MOST_FILES) -> None:
        self._path, self._most_bytes, self._most_files = path, most_bytes, most_files
        self._turned_away = 0
        self._failed = 0
        self._why = ""
        try:
            self._descriptor: int | None = _opened(path)
        except OSError as error:
            raise AuditFileError(
                f"the audit log {path} cannot be written: {error.strerror}; name another file, or none"
            ) from error
        about = os.fstat(self._descriptor)
        if stat.S_ISREG(about.st_mode) and (about.st_uid != os.geteuid() or about.st_mode & _OTHERS):
            os.close(self._descriptor)
            raise AuditFileError(
                f"the audit log {path} has mode {stat.S_IMODE(about.st_mode):04o} and belongs to user {about.st_uid}; "
                f"it must be the own file of user {os.geteuid()}: `chmod 600 {path}`, or name another"
            )
        self._waiting: queue.Queue[bytes | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="audit", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        """Lines that could not be written."""
        return self._turned_away + self._failed

    @property
    def fault(self) -> str:
        """Why the newest line could not be written; empty if it was."""
        return "the disk is too slow" if self._waiting.full() else self._why

    def write(self, line: bytes) -> None:
        """Append a line, which ends with a newline; returns at once."""
        try:
            self._waiting.put_nowait(line)
        except queue.Full:
            self._turned_away += 1

    def close(self) -> None:
        """Write what waits, as far as the disk takes it in time."""
        try:
            self._waiting.put(None, timeout=_CLOSE_DEADLINE_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_DEADLINE_S)

    # --- in the thread ------------------------------------------------------------------------------

    def _run(self) -> None:
        sync_s: float | None = None
        while True:
            try:
                line = self._waiting.get(timeout=None if sync_s is None else sync_s - time.monotonic())
            except (queue.Empty, ValueError):  # or it was due before
                self._sync()
                sync_s = None
                continue
            if line is None:
                break
            try:
                self._append(line)
                self._why = ""
            except OSError as error:
                self._failed += 1
                self._why = error.strerror or str(error)
            if sync_s is None:
                sync_s = time.monotonic() + _SYNC_PERIOD_S
        self._sync()
        self._forget()

    def _append(self, line: bytes) -> None:
        descriptor = self._current()
        about = os.fstat(descriptor)
        if stat.S_ISREG(about.st_mode):
            if about.st_size and about.st_size + len(line) > self._most_bytes:
                self._rotate()
                descriptor = self._current()
            elif about.st_size and os.pread(descriptor, 1, about.st_size - 1) != b"\n":
                line = b"\n" + line  # a line was torn
        written = os.write(descriptor, line)
        if written < len(line):
            raise OSError(0, "only a part of a line could be written")

    def _current(self) -> int:
        """The open file, unless somebody has moved it or taken it away since."""
        if self._descriptor is not None and not _is_at(self._descriptor, self._path):
            self._forget()
        if self._descriptor is None:
            self._descriptor = _opened(self._path)
        return self._descriptor

    def _rotate(self) -> None:
        self._forget()
        names = [self._path, *older(self._path, self._most_files)]
        for newer, old in reversed(list(itertools.pairwise(names))):
            if newer.exists():
                newer.replace(old)
        if len(names) == 1:
            self._path.unlink()

    def _sync(self) -> None:
        try:
            if self._descriptor is not None:
                os.fdatasync(self._descriptor)
        except OSError:
            pass  # a device that keeps nothing; a disk that fails says so when it is written to

    def _forget(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def older(path: Path, most_files: int = MOST_FILES) -> Iterator[Path]:
    """Names of the files that were written before `path`, the newest of them first."""
    return (path.with_name(f"{path.name}.{number}") for number in range(1, most_files))


def default_audit_file(cell: str) -> Path:
    """Where `deltaq up` keeps the audit log of a cell: with the user's state, which outlives a restart of the machine.

    Raises:
        AuditFileError: if the folder cannot be made, or the file is not this user's.
    """
    given = os.environ.get("XDG_STATE_HOME")
    folder = (Path(given) if given else Path.home() / ".local" / "state") / "deltaq"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise AuditFileError(f"{folder} cannot be made: {error.strerror}") from error
    file = folder / audit_file_name(cell)
    if file.exists() and not os.access(file, os.R_OK | os.W_OK):
        raise AuditFileError(f"{file} is there, and this user cannot write to it")
    return file


def audit_file_name(cell: str) -> str:
    """What the file of a cell's audit log is called, where nobody names it."""
    return f"audit-{cell}.jsonl"


def _opened(path: Path) -> int:
    # non-blocking: a pipe that nobody reads is an error, and not the end of the thread
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK
    return os.open(path, flags, 0o600)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        there = path.stat()
    except OSError:
        return False
    ours = os.fstat(descriptor)
    return (ours.st_dev, ours.st_ino) == (there.st_dev, there.st_ino)
