"""A lock in shared memory that passes on in the moment in which its owner dies, however it dies.

The kernel hands a robust mutex on before it takes the dead process's memory away. The end of a pipe, or a process
descriptor, shows that end only after it: up to a cycle later, for a process as large as a Robot Server.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import os

MUTEX_BYTES = 64
"""More than a pthread_mutex_t has on any machine of 64 bit."""

_PROCESS_SHARED = _ROBUST = 1


class OwnerMutex:
    """One mutex.

    Args:
        memory: shared by both processes.
        offset: where it lies, a multiple of eight.
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
        """Wait until its owner lets go of it, or has died."""
        self._do("pthread_mutex_lock", self._mutex)

    def let_go(self) -> None:
        """Pass it on; only its owner does."""
        self._do("pthread_mutex_unlock", self._mutex)

    def _do(self, name: str, *arguments: object) -> None:
        error = getattr(self._libc, name)(*arguments)
        if error not in (0, errno.EOWNERDEAD):
            raise OSError(error, f"{name}: {os.strerror(error)}")
