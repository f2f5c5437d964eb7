"""The key of a launch's guarded realm: made when the launch starts, gone when the last launch that uses it ends.

It lies in the user's runtime folder, in a file that every launch using it keeps locked. A launch that finds the file
unlocked is the first, and makes a new key; one that starts a single service again joins the others by the same key. The
lock goes with the process, however it ends, so that no key outlives its launches for long enough to be used again.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deltaq_protocol.secret_file import faults_of_secret
from deltaq_services.guarded_key import GuardedKeyError, key_file_of_launch, new_key


class LaunchKey:
    """The key of one realm, as long as this is open.

    Args:
        realm: its name, as `guarded_key.realm_of` has it.

    Attributes:
        file: that holds the key.

    Raises:
        RuntimeFolderError: if the user has no folder of their own.
        GuardedKeyError: if the file cannot be written, or is not the user's own secret.
    """

    def __init__(self, realm: str) -> None:
        self.file = key_file_of_launch(realm)
        with _one_at_a_time(self.file.parent):
            try:
                flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
                self._descriptor = os.open(self.file, flags, 0o600)
            except OSError as error:
                raise GuardedKeyError(f"{self.file} cannot be written: {error.strerror}") from error
            if faults := faults_of_secret(os.fstat(self._descriptor), self.file, "deltaq up"):
                os.close(self._descriptor)
                raise GuardedKeyError(f"{self.file} {faults[0]}")
            if self._is_alone():
                os.ftruncate(self._descriptor, 0)
                os.pwrite(self._descriptor, new_key(), 0)
            fcntl.flock(self._descriptor, fcntl.LOCK_SH)

    def close(self) -> None:
        """Use the key no more; the last one removes it."""
        with _one_at_a_time(self.file.parent):
            if self._is_alone():
                self.file.unlink(missing_ok=True)
            os.close(self._descriptor)

    def _is_alone(self) -> bool:
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


@contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    """Nobody else makes or removes a key in this folder within the block."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
