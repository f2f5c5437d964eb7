"""What seals the guarded realm: without it HLI, SIM and Robot Servers do not start.

Whoever starts a cell's services on one machine makes a key for them, see
`deltaq_deploy.launch.launch_key`. The user gives one only where they are started one by one, and
an identity for each where they run on several machines: see
`deltaq_services.service_identity`.
"""

from __future__ import annotations

import os
import secrets
from hashlib import blake2b
from pathlib import Path

from deltaq_cell.description import CellDescription
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.seal import Seal
from deltaq_protocol.seal_keys import KEY_BYTES, RealmKey
from deltaq_protocol.secret_file import contents, faults_of_secret
from deltaq_services.runtime_folder import runtime_folder

KEY_FILE = "DELTAQ_GUARDED_KEY_FILE"
"""Environment variable: path of the file that holds the key, in hexadecimal."""

_MAKES = "deltaq key FILE"


class GuardedKeyError(DeltaqError):
    """A key that is missing, invalid, or not a secret."""


def guarded_seal(cell: CellDescription, service: str = "", watched: str = "") -> Seal:
    """A seal of a cell's guarded messages, for this process.

    The keys are those of the identity that the environment names, or the one key of the file that it names; on the
    loopback also that of a launch of the same user.

    Args:
        cell: the cell.
        service: name of the service that seals; empty for a process that only watches.
        watched: the service whose messages a watching process reads, best with the identity of that service.

    Raises:
        GuardedKeyError: there is no key, or it is not this user's secret.
        IdentityError: there is no identity, it is not this user's secret, or it belongs to another service.
    """
    if not os.environ.get(IDENTITY):
        return Seal(RealmKey(_key_in(_file_of(cell))))
    if os.environ.get(KEY_FILE):
        raise GuardedKeyError(
            f"{IDENTITY} and {KEY_FILE} are both set, and a realm has either identities or one key; unset one of them"
        )
    from deltaq_services.service_identity import pair_keys

    return Seal(pair_keys(cell, Path(os.environ[IDENTITY]), service, watched))


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
        keep: do not overwrite an existing key.

    Raises:
        GuardedKeyError: the file cannot be written, it exists and `keep` is false, or the key that is kept is not a
            secret key.
    """
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if not keep:
            raise GuardedKeyError(
                f"{file} exists already; a key is never overwritten, name another file"
            ) from None
        _key_in(file)
        return
    except OSError as error:
        raise GuardedKeyError(f"{file} cannot be written: {error.strerror}") from error
    with os.fdopen(descriptor, "wb") as key:
        key.write(new_key())


def _file_of(cell: CellDescription) -> Path:
    if file := os.environ.get(KEY_FILE):
        return Path(file)
    realm = realm_of(cell)
    if realm is None:
        raise GuardedKeyError(
            f"{off_loopback(cell)} of cell {cell.cell} can be reached from outside this machine, and neither "
            f"{IDENTITY} names an identity nor {KEY_FILE} a key; make identities with `deltaq keys CELL --to FOLDER`, "
            "or one key with `deltaq key FILE` for HLI, SIM and every Robot Server, or listen on 127.0.0.1"
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
        about, text = contents(file)
    except OSError as error:
        raise GuardedKeyError(f"{KEY_FILE}: {file} cannot be read: {error.strerror}") from error
    if faults := faults_of_secret(about, file, _MAKES):
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
