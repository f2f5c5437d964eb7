"""The identity of a service, and what it can say under it: keys for each of those that it speaks with."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cryptography import x509

from deltaq_cell.description import CellDescription
from deltaq_protocol.certified import encryption
from deltaq_protocol.certified.certificate import cell_in, certificate_in, check_authority, now_utc
from deltaq_protocol.certified.identity import Identity, read_believed
from deltaq_protocol.certified.names import AUTHORITY_FILE, IDENTITY, IdentityError, IdentityKind
from deltaq_protocol.errors import Severity
from deltaq_protocol.sayings import HLI, services
from deltaq_protocol.seal_keys import PairKeys

_log = logging.getLogger(__name__)


def pair_keys(cell: CellDescription, folder: Path, service: str = "", watched: str = "") -> PairKeys:
    """The keys of a service of a cell.

    Its time is looked at here, when a process begins; none ends in motion because a certificate does.

    Args:
        cell: the cell.
        folder: of the identity, or the one in which it lies under its service's name.
        service: its name; empty for who only watches, under whatever identity of a service there is.
        watched: the service that such a one watches.

    Raises:
        IdentityError: if there is none, it is another's, or not valid.
    """
    identity = service_identity(cell, folder, service, watched)
    if warning := identity.warning(now_utc()):
        _log.warning(warning)
    return PairKeys(identity.name, cell.cell, tuple(cell.robots), _secrets(cell, identity))


def service_identity(cell: CellDescription, folder: Path, service: str = "", watched: str = "") -> Identity:
    """The identity of a service, from its folder or the one above; the arguments as those of `pair_keys`.

    Raises:
        IdentityError: if there is none, it is another's, or not valid.
    """
    own = folder / (service or watched)
    identity = _of_cell(cell, own if own.is_dir() else folder)
    if identity.kind is not IdentityKind.SERVICE:
        raise IdentityError(
            f"{identity.folder} is the identity of {identity.name}, which is no service: {identity.kind}s connect to "
            "the HLI"
        )
    if service and identity.name != service:
        raise IdentityError(
            f"{identity.folder} is the identity of {identity.name}, and this is {service}; name the folder {service} "
            "that `deltaq keys` made, or the one above it"
        )
    return identity


def identity_faults(cell: CellDescription, folder: Path) -> list[tuple[Severity, str]]:
    """What is wrong with an identity for a cell, or with those of its services in a folder, or will be soon."""
    found: list[tuple[Severity, str]] = []
    present = [folder / name for name in services(tuple(cell.robots)) if (folder / name).is_dir()]
    for own in present or [folder]:
        try:
            identity = _of_cell(cell, own)
            _secrets(cell, identity)
        except IdentityError as error:
            found.append(("error", str(error)))
        else:
            if warning := identity.warning(now_utc()):
                found.append(("warning", warning))
    return found


def _of_cell(cell: CellDescription, folder: Path) -> Identity:
    identity = Identity.read(folder, now_utc())
    if identity.cell != cell.cell:
        raise IdentityError(
            f"{folder} is an identity of cell {identity.cell}, and this is cell {cell.cell}; "
            "`deltaq keys CELL --to FOLDER` makes those of a cell"
        )
    return identity


def _secrets(cell: CellDescription, identity: Identity) -> dict[str, bytes]:
    now = now_utc()
    return {name: identity.secret_with(name, now) for name in services(tuple(cell.robots))}


def authority_of_clients(cell: CellDescription, environment: Mapping[str, str]) -> x509.Certificate:
    """The authority whose operators and controllers an HLI believes: that of a file, or of its own identity.

    Raises:
        IdentityError: if its certificate is missing, of another cell, or not valid.
    """
    named = environment.get(AUTHORITY_FILE)
    if not named:
        return service_identity(cell, Path(environment[IDENTITY]), HLI).authority
    authority = certificate_in(read_believed(Path(named)), named)
    check_authority(authority, named, now_utc())
    if cell_in(authority) != cell.cell:
        raise IdentityError(
            f"{named} is the authority of cell {cell_in(authority)}, and this is cell {cell.cell}"
        )
    return authority


def tls_settings(cell: CellDescription, folder: Path, service: str = "") -> dict[str, Any]:
    """Certificates of a service's session over TLS, as zenoh's configuration has them.

    Args:
        cell: the cell.
        folder: of the identity, or the one in which it lies under its service's name.
        service: its name, or that of the one that is watched.

    Raises:
        IdentityError: if there is no identity of this cell, or it is not valid.
    """
    own = folder / service
    return encryption.tls_settings(_of_cell(cell, own if own.is_dir() else folder).folder)
