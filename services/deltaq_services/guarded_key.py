"""The key of the guarded realm: needed as soon as an endpoint of HLI, SIM or Robot Servers leaves the loopback."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from deltaq_cell.description import CellDescription
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.seal import KEY_BYTES, UNSEALED, KeyedSeal, Seal

KEY_FILE = "DELTAQ_GUARDED_KEY_FILE"
"""Environment variable: path of the file that holds the key, in hexadecimal."""


class GuardedKeyError(DeltaqError):
    """A key that is needed and missing, or invalid."""


def guarded_seal(cell: CellDescription) -> Seal:
    """The seal of a cell's guarded messages: none as long as all of them stay on the loopback.

    Raises:
        GuardedKeyError: if they do not, and there is no key.
    """
    field = off_loopback(cell)
    if field is None:
        return UNSEALED
    file = os.environ.get(KEY_FILE)
    if not file:
        raise GuardedKeyError(
            f"{field} of cell {cell.cell} can be reached from outside this machine, and {KEY_FILE} names no key; make "
            "one with `deltaq key FILE`, give the same file to HLI, SIM and every Robot Server, or listen on 127.0.0.1"
        )
    return KeyedSeal(_read(Path(file)))


def off_loopback(cell: CellDescription) -> str | None:
    """The first field of a cell that lets the guarded realm leave the loopback, with its value; None if none does."""
    endpoints = {"sim": cell.sim} | {
        f"robots.{name}.server": robot.server for name, robot in cell.robots.items()
    }
    for field, text in endpoints.items():
        if not Endpoint.parse(text).is_loopback:
            return f"{field} ({text})"
    return None


def write_new_key(file: Path) -> None:
    """Make a random key, in a file that only its owner may read.

    Raises:
        GuardedKeyError: if the file is there already or cannot be written.
    """
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise GuardedKeyError(
            f"{file} is there already; a key is never written over, name another file"
        ) from None
    except OSError as error:
        raise GuardedKeyError(f"{file} cannot be written: {error.strerror}") from error
    with os.fdopen(descriptor, "w", encoding="ascii") as key:
        key.write(secrets.token_hex(KEY_BYTES) + "\n")


def _read(file: Path) -> bytes:
    try:
        text = file.read_text(encoding="ascii")
    except OSError as error:
        raise GuardedKeyError(f"{KEY_FILE}: {file} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError:
        text = ""  # reported like any other invalid key, and never shown
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise GuardedKeyError(
            f"{KEY_FILE}: {file} holds no key, which is {2 * KEY_BYTES} hexadecimal digits; make one with "
            "`deltaq key FILE`"
        )
    return key
