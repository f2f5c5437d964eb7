"""A record of every cycle of the emulated robot, as a table that can be read while it grows."""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

from deltaq_emulator.record_folder import MOST_ROWS, RecordError, RecordFolder
from deltaq_emulator.sample import Sample


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
