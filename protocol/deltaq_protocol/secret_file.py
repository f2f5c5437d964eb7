"""Checks of file permissions: a secret may be read only by its owner, a trusted file written only by its owner."""

import os
import stat
from collections.abc import Sequence
from pathlib import Path

_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_ROOT = 0
_MOST_BYTES = 64 * 1024


def contents(file: Path) -> tuple[os.stat_result, bytes]:
    """The status of a file and its first 64 KiB, from one opening, so that the file cannot be exchanged in between.

    Raises:
        OSError: if it cannot be read.
    """
    with file.open("rb") as opened:
        return os.fstat(opened.fileno()), opened.read(_MOST_BYTES)


def faults_of_secret(about: os.stat_result, file: Path, makes: str) -> Sequence[str]:
    """Why a file is not secret to this user, and the remedy; empty if it is.

    Args:
        about: the file's status (`os.stat`).
        file: its path, for the error.
        makes: the command that makes one.
    """
    faults = []
    if not stat.S_ISREG(about.st_mode):
        faults.append(f"is no regular file; name one that `{makes}` made")
    if about.st_uid != os.geteuid():
        faults.append(
            f"belongs to user {about.st_uid}, and this is user {os.geteuid()}; `sudo chown {os.geteuid()} {file}`, "
            f"or make one of your own with `{makes}`"
        )
    mode = stat.S_IMODE(about.st_mode)
    if mode & _OTHERS:
        faults.append(
            f"has mode {mode:04o}, and other users may read or write it; at most 0600 is allowed: `chmod 600 {file}`, "
            "or make a new key if another user may have read it"
        )
    return faults


def faults_of_believed(about: os.stat_result, file: Path) -> Sequence[str]:
    """Why other users could have written a file, and the remedy; empty if only this user and root could."""
    faults = []
    if not stat.S_ISREG(about.st_mode):
        faults.append("is no regular file")
    if about.st_uid not in (os.geteuid(), _ROOT):
        faults.append(
            f"belongs to user {about.st_uid}, and this is user {os.geteuid()}, who would trust it; "
            f"`sudo chown {os.geteuid()} {file}`, if it is unchanged"
        )
    mode = stat.S_IMODE(about.st_mode)
    if mode & _OTHERS_WRITE:
        faults.append(
            f"has mode {mode:04o}, and other users may write it; `chmod go-w {file}`, if it is unchanged"
        )
    return faults
