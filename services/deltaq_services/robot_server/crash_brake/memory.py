"""The memory that a Robot Server shares with the process that brakes its robot should it die."""

from __future__ import annotations

import mmap

from deltaq_services.robot_server.crash_brake.owner_mutex import MUTEX_BYTES, OwnerMutex
from deltaq_services.robot_server.crash_brake.record import (
    NOTHING,
    SENT,
    CrashRecords,
    LastReply,
    PeerAddress,
)

_FLAGS_BYTES = 8
_ARMED, _RELEASED = 0, 1


class CrashMemory:
    """Records, the mutex that the Robot Server owns while it lives, and two flags.

    Args:
        file: the memory, of `bytes_for` at least.
        records: their layout.

    Attributes:
        mutex: passed on when the Robot Server dies.
    """

    def __init__(self, file: mmap.mmap, records: CrashRecords) -> None:
        self._file, self._records = file, records
        self._flags = records.total
        self._number = NOTHING
        self.mutex = OwnerMutex(file, records.total + _FLAGS_BYTES)

    @staticmethod
    def bytes_for(records: CrashRecords) -> int:
        """How much memory such records need with all that lies beside them."""
        return records.total + _FLAGS_BYTES + MUTEX_BYTES

    @property
    def armed(self) -> bool:
        """Whether the process beside the Robot Server is ready."""
        return self._file[self._flags + _ARMED] != 0

    @armed.setter
    def armed(self, is_armed: bool) -> None:
        self._file[self._flags + _ARMED] = is_armed

    @property
    def released(self) -> bool:
        """Whether the Robot Server ended as it should: there is nothing to brake."""
        return self._file[self._flags + _RELEASED] != 0

    @released.setter
    def released(self, is_released: bool) -> None:
        self._file[self._flags + _RELEASED] = is_released

    def write(self, body: bytes, peer: PeerAddress, time_s: float) -> None:
        """Leave a record; its reply is about to be sent.

        Args:
            body: of the record.
            peer: address of the KRC that is answered.
            time_s: when its telegram came.
        """
        self._number += 1
        place, record = self._records.sealed(body, self._number, peer, time_s)
        self._file[place : place + len(record)] = record

    def sent(self) -> None:
        """The reply of the record that was written last was handed to the network."""
        SENT.pack_into(self._file, self._records.sent_at, self._number)

    def clear(self) -> None:
        """Leave no record: no brake can follow the reply that is sent now."""
        self._file[: self._records.sent_at] = bytes(self._records.sent_at)

    def newest(self) -> LastReply | None:
        """What the Robot Server left."""
        return self._records.newest(self._file[: self._records.total])

    def close(self) -> None:
        """Let go of the memory, so that it can be closed."""
        del self.mutex
