"""A record of every cycle of the emulated robot, as a table that can be read while it grows."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError


class CsvRecorder:
    """Writes one row a cycle: cycle, time_s, q_1 … q_n, q_set_1 … q_set_n (rad or m), state.

    Rows are flushed one by one. A write that fails ends the record, and nothing else.

    Args:
        cycle_s: sample time.
        joints: of the robot.
        folder: in which the panel may begin records; None: nowhere.

    Attributes:
        path: the file being written, or None.
        error: why the last record ended, if an error ended it.
    """

    def __init__(self, cycle_s: float, joints: int, folder: RecordFolder | None = None) -> None:
        self._folder = folder
        self._rows_left: int | None = None
        self._cycle_s = cycle_s
        self._joints = joints
        self._file: TextIO | None = None
        self.path: Path | None = None
        self.error: str | None = None

    def start(self, path: Path | str) -> None:
        """Begin a record where whoever started this process wants it; one that is being written ends.

        Raises:
            RecordError: if the file cannot be written.
        """
        self.stop()
        try:
            file = Path(path).open("w", encoding="utf-8", buffering=1, newline="")  # noqa: SIM115 - closed by stop()
        except OSError as error:
            raise RecordError(
                f"{path}: cannot be written: {error.strerror}; give a file in a folder that is there"
            ) from error
        self._begin(file, Path(path), None)

    def start_in_folder(self, name: str) -> None:
        """Begin a record in a new file of the folder for records; one that is being written ends.

        Raises:
            RecordError: if there is no such folder, or it can have no such file.
        """
        if self._folder is None:
            raise RecordError("records are written nowhere; start the emulator with `--records FOLDER`")
        file = self._folder.new_file(name)
        self.stop()
        self._begin(file, self._folder.path / name, MOST_ROWS)

    def _begin(self, file: TextIO, path: Path, rows: int | None) -> None:
        numbers = range(1, self._joints + 1)
        header = ["cycle", "time_s", *(f"q_{i}" for i in numbers), *(f"q_set_{i}" for i in numbers), "state"]
        self._file, self._rows_left, self.path, self.error = file, rows, path, None
        try:
            file.write(",".join(header) + "\n")
        except OSError as error:
            self.stop()
            raise RecordError(f"{path}: cannot be written: {error.strerror}") from error

    def row(self, sample: Sample) -> None:
        """Write a cycle, if there is a record."""
        if self._file is None:
            return
        if self._rows_left is not None:
            if not self._rows_left:
                self.error = f"{self.path}: {MOST_ROWS} cycles are in it, and no more are allowed"
                self.stop()
                return
            self._rows_left -= 1
        numbers = [sample.cycle * self._cycle_s, *sample.q.tolist(), *sample.q_setpoint.tolist()]
        try:
            self._file.write(f"{sample.cycle},{','.join(f'{x:.12g}' for x in numbers)},{sample.state}\n")
        except OSError as error:
            self.error = f"{self.path}: {error.strerror}"
            self.stop()

    def stop(self) -> None:
        """End the record."""
        file, self._file, self.path = self._file, None, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                self.error = f"{file.name}: {error.strerror}"


@dataclass(frozen=True)
class Sample:
    """One cycle of the emulated robot.

    Attributes:
        cycle: cycles since the controller was switched on.
        q: (n,) actual joints at the beginning of the cycle [rad or m].
        q_setpoint: (n,) setpoint of the drives during the cycle, corrections included [rad or m].
        message: the message on the pendant, if any.
        counters: datagrams and cycles by class, see `deltaq_emulator.replies.Reply`, and `clamped`, `sent`,
            `delay` (the telegram's element), `late_counted` (against the budget).
    """

    cycle: int
    ipoc: int
    q: Array
    q_setpoint: Array
    state: KrcState
    message: str | None
    counters: Mapping[str, int]


# The folder in which whoever reaches the emulator's panel may write records: new files there, and nothing else. Any
# process on the machine reaches the panel. So it names a file and no path, no file is written over, no link is
# followed, and there is an end to how many there are and how long they get.

MOST_RECORDS = 100
"""Files that the panel of one process writes."""
MOST_ROWS = 1_000_000
"""Cycles in each: more than three hours at 12 ms, and some 300 MB of an arm with six joints."""
_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}")


class RecordError(DeltaqError):
    """A recording file that cannot be written."""


class RecordFolder:
    """A folder that was there when the emulator started; it stays the same one, whatever becomes of its path.

    Args:
        path: of the folder.

    Raises:
        RecordError: if there is no such folder, or a link stands for it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._begun = 0
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError as error:
            raise RecordError(f"--records {path}: is no folder ({error.strerror}); make it first") from error

    def close(self) -> None:
        """Let go of the folder."""
        os.close(self._descriptor)

    def new_file(self, name: str) -> TextIO:
        """Make a file of this name.

        Raises:
            RecordError: if it is the name of no file, the file is there already, or it cannot be made.
        """
        if not _NAME.fullmatch(name):
            raise RecordError(
                f"path: {name[:100]!r} is no name of a file in {self.path}; give one of at most 100 letters, digits, "
                "'_', '-' and '.', without a folder"
            )
        if self._begun >= MOST_RECORDS:
            raise RecordError(
                f"{MOST_RECORDS} records were begun, and no more are allowed; start the emulator again"
            )
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        try:
            descriptor = os.open(name, flags, 0o644, dir_fd=self._descriptor)
        except FileExistsError:
            raise RecordError(
                f"path: {self.path / name} exists already; no file is overwritten, give another name"
            ) from None
        except OSError as error:
            raise RecordError(f"path: {self.path / name} cannot be written: {error.strerror}") from error
        self._begun += 1
        return os.fdopen(descriptor, "w", encoding="utf-8", buffering=1, newline="")
