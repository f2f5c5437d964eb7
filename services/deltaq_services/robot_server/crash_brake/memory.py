"""The memory that a Robot Server shares with the process that brakes its robot should it die."""

import ctypes
import errno
import mmap
import os

from deltaq_services.robot_server.crash_brake.record import (
    NOTHING,
    SENT,
    CrashRecords,
    LastReply,
    PeerAddress,
)

# A lock in shared memory that passes on in the moment in which its owner dies, however it dies.
#
# The kernel hands a robust mutex on before it takes the dead process's memory away. The end of a pipe, or a
# process descriptor, shows that end only after it: up to a cycle later, for a process as large as a Robot
# Server.

MUTEX_BYTES = 64
"""More than a pthread_mutex_t has on any machine of 64 bit."""

_PROCESS_SHARED = _ROBUST = 1


class OwnerMutex:
    """One mutex.

    Args:
        memory: shared by both processes.
        offset: its place in the memory [bytes], a multiple of eight.
    """

    def __init__(self, memory: mmap.mmap, offset: int) -> None:
        self._libc = ctypes.CDLL(None)
        self._mutex = (ctypes.c_char * MUTEX_BYTES).from_buffer(memory, offset)

    def own(self) -> None:
        """Make it, and own it by this thread."""
        attributes = (ctypes.c_char * MUTEX_BYTES)()
        self._do("pthread_mutexattr_init", attributes)
        self._do("pthread_mutexattr_setpshared", attributes, _PROCESS_SHARED)
        self._do("pthread_mutexattr_setrobust", attributes, _ROBUST)
        self._do("pthread_mutex_init", self._mutex, attributes)
        self._do("pthread_mutex_lock", self._mutex)

    def wait(self) -> None:
        """Wait until its owner releases it, or has died."""
        self._do("pthread_mutex_lock", self._mutex)

    def let_go(self) -> None:
        """Pass it on; only its owner does."""
        self._do("pthread_mutex_unlock", self._mutex)

    def _do(self, name: str, *arguments: object) -> None:
        error = getattr(self._libc, name)(*arguments)
        if error not in (0, errno.EOWNERDEAD):
            raise OSError(error, f"{name}: {os.strerror(error)}")


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
        """Size of the shared memory for such records [bytes]."""
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
        """Whether the Robot Server ended in order, so that there is nothing to brake."""
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
        """Note that the reply of the last record was handed to the network."""
        SENT.pack_into(self._file, self._records.sent_at, self._number)

    def clear(self) -> None:
        """Leave no record: no brake can follow the reply that is sent now."""
        self._file[: self._records.sent_at] = bytes(self._records.sent_at)

    def newest(self) -> LastReply | None:
        """The newest record of the Robot Server."""
        return self._records.newest(self._file[: self._records.total])

    def close(self) -> None:
        """Release the memory, so that it can be closed."""
        del self.mutex
