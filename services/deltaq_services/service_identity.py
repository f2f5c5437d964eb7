"""The identity of a service: its certificate over TLS, and the authority of its cell."""

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

_log = logging.getLogger(__name__)


def service_identity(cell: CellDescription, folder: Path, service: str) -> Identity:
    """The identity of a service, from its folder or the one above.

    Raises:
        IdentityError: if there is none, it belongs to another service, or is not valid.
    """
    identity = _of_cell(cell, _own(folder, service))
    if identity.kind is not IdentityKind.SERVICE:
        raise IdentityError(
            f"{identity.folder} is the identity of {identity.name}, which is no service: {identity.kind}s connect to "
            "the HLI"
        )
    if identity.name != service:
        raise IdentityError(
            f"{identity.folder} is the identity of {identity.name}, and this is {service}; name the folder {service} "
            "that `deltaq keys` made, or the one above it"
        )
    return identity


def identity_faults(cell: CellDescription, folder: Path) -> list[tuple[Severity, str]]:
    """Present and coming faults of a cell's identity, or of the identities of its services in a folder."""
    found: list[tuple[Severity, str]] = []
    present = [folder / name for name in services(tuple(cell.robots)) if (folder / name).is_dir()]
    for own in present or [folder]:
        try:
            identity = _of_cell(cell, own)
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
            "`deltaq keys --cell CELL --output FOLDER` makes those of a cell"
        )
    return identity


def authority_of_clients(cell: CellDescription, environment: Mapping[str, str]) -> x509.Certificate:
    """The authority whose operators and controllers an HLI accepts: from a file, or that of its own identity.

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


def tls_settings(
    cell: CellDescription, folder: Path, service: str, only_watches: bool = False
) -> dict[str, Any]:
    """Certificates of a service's session over TLS, as zenoh's configuration has them.

    The time is looked at here, when a process begins; no motion ends because a certificate does.

    Args:
        cell: the cell.
        folder: of the identity, or the one in which it lies under its service's name.
        service: its name, or that of the service that is watched.
        only_watches: any identity of the cell will do.

    Raises:
        IdentityError: if there is no such identity, or it is not valid.
    """
    if only_watches:
        return encryption.tls_settings(_of_cell(cell, _own(folder, service)).folder)
    identity = service_identity(cell, folder, service)
    if warning := identity.warning(now_utc()):
        _log.warning(warning)
    return encryption.tls_settings(identity.folder)


def _own(folder: Path, service: str) -> Path:
    own = folder / service
    return own if own.is_dir() else folder
