"""A record of every cycle of the emulated robot, as a table that can be read while it grows."""

from __future__ import annotations

import os
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

    Attributes:
        path: the file being written, or None.
        error: why the last record ended, if an error ended it.
    """

    def __init__(self, cycle_s: float, joints: int) -> None:
        self._cycle_s = cycle_s
        self._joints = joints
        self._file: TextIO | None = None
        self.path: Path | None = None
        self.error: str | None = None

    def start(self, path: Path | str) -> None:
        """Begin a record; one that is being written ends. A reader may cut the file short while it grows.

        Raises:
            DeltaqError: if the file cannot be written.
        """
        self.stop()
        numbers = range(1, self._joints + 1)
        header = ["cycle", "time_s", *(f"q_{i}" for i in numbers), *(f"q_set_{i}" for i in numbers), "state"]
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
            self._file = os.fdopen(descriptor, "w", encoding="utf-8", buffering=1, newline="")
            self.path, self.error = Path(path), None
            self._file.write(",".join(header) + "\n")
        except OSError as error:
            self.stop()
            raise DeltaqError(
                f"{path}: cannot be written: {error.strerror}; give a file in a folder that is there"
            ) from error

    def row(self, sample: Sample) -> None:
        """Write a cycle, if there is a record."""
        if self._file is None:
            return
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
