"""The folder of a user's running services; other users cannot enter it."""

import os
import stat
import tempfile
from pathlib import Path

from deltaq_protocol.errors import DeltaqError

_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class RuntimeFolderError(DeltaqError):
    """The folder for secrets is not private to this user."""


def runtime_folder() -> Path:
    """The folder, made if need be: in `XDG_RUNTIME_DIR`, or where that is not set, in the system's temporary folder.

    Raises:
        RuntimeFolderError: if it cannot be made, belongs to another user, or other users may enter it.
    """
    given = os.environ.get("XDG_RUNTIME_DIR")
    folder = (
        Path(given) / "deltaq" if given else Path(tempfile.gettempdir()) / f"deltaq-runtime-{os.geteuid()}"
    )
    return private_folder(folder, "let XDG_RUNTIME_DIR name a folder of your own")


def private_folder(folder: Path, remedy: str) -> Path:
    """A folder that only this user can enter; made if it does not exist.

    Args:
        folder: its path; the one above it exists.
        remedy: text for an error: what the user can do.

    Raises:
        RuntimeFolderError: it cannot be made, another user owns it, or others may enter it.
    """
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()  # a link would lead wherever its owner wants
    except OSError as error:
        raise RuntimeFolderError(f"{folder} cannot be made: {error.strerror}; {remedy}") from error
    if not stat.S_ISDIR(about.st_mode):
        raise RuntimeFolderError(f"{folder} is no folder; remove it, or {remedy}")
    if about.st_uid != os.geteuid():
        raise RuntimeFolderError(
            f"{folder} belongs to user {about.st_uid}, and this is user {os.geteuid()}; {remedy}"
        )
    mode = stat.S_IMODE(about.st_mode)
    if mode & _OTHERS:
        raise RuntimeFolderError(
            f"{folder} has mode {mode:04o}, and others may enter it; 0700 is needed: `chmod 700 {folder}`"
        )
    return folder
