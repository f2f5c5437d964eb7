"""The key of the guarded realm: without one HLI, SIM and Robot Servers do not start.

Whoever starts a cell's services makes a key for them, see `deltaq_launch.launch_key`; the user gives one only where
services of one cell run on several machines, or are started one by one.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Sequence
from hashlib import blake2b
from pathlib import Path

from deltaq_cell.description import CellDescription
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.seal import KEY_BYTES, Seal
from deltaq_services.runtime_folder import runtime_folder

KEY_FILE = "DELTAQ_GUARDED_KEY_FILE"
"""Environment variable: path of the file that holds the key, in hexadecimal."""

_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class GuardedKeyError(DeltaqError):
    """A key that is missing, invalid, or not a secret."""


def guarded_seal(cell: CellDescription) -> Seal:
    """A seal of a cell's guarded messages, for this process.

    The key is that of the file which the environment names; on the loopback also that of a launch of the same user.

    Raises:
        GuardedKeyError: if there is none, or it is not this user's secret.
    """
    return Seal(_key_in(_file_of(cell)))


def realm_of(cell: CellDescription) -> str | None:
    """The name of a cell's guarded realm, by its endpoints on this machine; None if one of them leaves it."""
    if off_loopback(cell) is not None:
        return None
    endpoints = " ".join((cell.sim, *(robot.server for robot in cell.robots.values())))
    return f"{cell.cell}-{blake2b(endpoints.encode(), digest_size=4).hexdigest()}"


def off_loopback(cell: CellDescription) -> str | None:
    """The first field of a cell that lets the guarded realm leave the loopback, with its value; None if none does."""
    endpoints = {"sim": cell.sim} | {
        f"robots.{name}.server": robot.server for name, robot in cell.robots.items()
    }
    for field, text in endpoints.items():
        if not Endpoint.parse(text).is_loopback:
            return f"{field} ({text})"
    return None


def key_file_of_launch(realm: str) -> Path:
    """Where a launch of this user keeps the key of a realm.

    Raises:
        RuntimeFolderError: if there is no folder that is this user's alone.
    """
    return runtime_folder() / f"{realm}.key"


def new_key() -> bytes:
    """The contents of a new key file."""
    return (secrets.token_hex(KEY_BYTES) + "\n").encode()


def write_new_key(file: Path, *, keep: bool = False) -> None:
    """Make a random key, in a file that only its owner may read.

    Args:
        file: to write.
        keep: leave one that is there already as it is.

    Raises:
        GuardedKeyError: if the file cannot be written or, unless it is to be kept, is there already; or if the one
            that is kept is no secret key.
    """
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if not keep:
            raise GuardedKeyError(
                f"{file} is there already; a key is never written over, name another file"
            ) from None
        _key_in(file)
        return
    except OSError as error:
        raise GuardedKeyError(f"{file} cannot be written: {error.strerror}") from error
    with os.fdopen(descriptor, "wb") as key:
        key.write(new_key())


def faults_of_secret(about: os.stat_result, file: Path) -> Sequence[str]:
    """Why a file is not this user's secret, with what to do; empty if it is."""
    faults = []
    if not stat.S_ISREG(about.st_mode):
        faults.append("is no regular file; name one that `deltaq key FILE` made")
    if about.st_uid != os.geteuid():
        faults.append(
            f"belongs to user {about.st_uid}, and this is user {os.geteuid()}; `sudo chown {os.geteuid()} {file}`, "
            "or make one of your own with `deltaq key FILE`"
        )
    mode = stat.S_IMODE(about.st_mode)
    if mode & _OTHERS:
        faults.append(
            f"has mode {mode:04o}, and others than its owner may use it; at most 0600 is allowed: `chmod 600 {file}`, "
            "or a new key if somebody may have read it"
        )
    return faults


def _file_of(cell: CellDescription) -> Path:
    if file := os.environ.get(KEY_FILE):
        return Path(file)
    realm = realm_of(cell)
    if realm is None:
        raise GuardedKeyError(
            f"{off_loopback(cell)} of cell {cell.cell} can be reached from outside this machine, and {KEY_FILE} names "
            "no key; make one with `deltaq key FILE`, give the same file to HLI, SIM and every Robot Server, or "
            "listen on 127.0.0.1"
        )
    launched = key_file_of_launch(realm)
    if launched.exists():
        return launched
    raise GuardedKeyError(
        f"the guarded realm of cell {cell.cell} has no key: {KEY_FILE} is not set, and no `deltaq up` of user "
        f"{os.geteuid()} runs this cell; start services with `deltaq up` (one of them with `deltaq up --only NAME`), "
        f"or make a key with `deltaq key FILE` and set {KEY_FILE}=FILE for HLI, SIM and every Robot Server"
    )


def _key_in(file: Path) -> bytes:
    try:
        with file.open("rb") as opened:
            about = os.fstat(opened.fileno())
            text = opened.read(4 * KEY_BYTES)
    except OSError as error:
        raise GuardedKeyError(f"{KEY_FILE}: {file} cannot be read: {error.strerror}") from error
    if faults := faults_of_secret(about, file):
        raise GuardedKeyError(f"{KEY_FILE}: {file} {faults[0]}")
    try:
        key = bytes.fromhex(text.decode("ascii"))
    except ValueError:
        key = b""  # reported like any other invalid key, and never shown
    if len(key) != KEY_BYTES:
        raise GuardedKeyError(
            f"{KEY_FILE}: {file} holds no key, which is {2 * KEY_BYTES} hexadecimal digits; make one with "
            "`deltaq key FILE`"
        )
    return key
