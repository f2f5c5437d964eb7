"""Certificates of a session over TLS, as zenoh's configuration has them."""

import os
from pathlib import Path
from typing import Any

from deltaq_protocol.certified.names import (
    AUTHORITY,
    CERTIFICATE,
    CLIENT_IDENTITY,
    IDENTITY,
    KEY,
    IdentityError,
)
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.sayings import HLI


def tls_settings(folder: Path) -> dict[str, Any]:
    """TLS settings of an identity, as zenoh's configuration has them; both ends show certificates.

    Certificates name services and people, not hosts, so no host name is verified; access control and proofs decide
    who may send under which key.
    """
    key, certificate = str(folder / KEY), str(folder / CERTIFICATE)
    return {
        "root_ca_certificate": str(folder / AUTHORITY),
        "listen_private_key": key,
        "listen_certificate": certificate,
        "connect_private_key": key,
        "connect_certificate": certificate,
        "enable_mtls": True,
        "verify_name_on_connect": False,
    }


def is_encrypted(endpoint: str) -> bool:
    """Whether an endpoint is one of TLS."""
    return Endpoint.parse(endpoint).transport == "tls"


def client_tls(hli: str, identity: str | os.PathLike[str] | None = None) -> dict[str, Any] | None:
    """Certificates of a client's session to an HLI; None if its endpoint is not encrypted.

    Args:
        hli: endpoint of the HLI.
        identity: folder of the client's identity; None: the identity that the environment names, or on the HLI's
            machine the HLI's own.

    Raises:
        InvalidEndpointError: the endpoint has no valid form.
        IdentityError: the endpoint is encrypted, and there is no identity.
    """
    if not is_encrypted(hli):
        return None
    folder = _folder(identity or os.environ.get(CLIENT_IDENTITY))
    if folder is None:
        raise IdentityError(
            f"{hli} is encrypted, and {CLIENT_IDENTITY} names no identity; the operator of the cell makes one with "
            "`deltaq keys --cell CELL --output FOLDER --controller NAME` or `--operator NAME`"
        )
    for name in (AUTHORITY, CERTIFICATE, KEY):
        if not os.access(folder / name, os.R_OK):
            raise IdentityError(
                f"{folder} is no identity for {hli}: {name} is missing there, or cannot be read"
            )
    return tls_settings(folder)


def _folder(named: str | os.PathLike[str] | None) -> Path | None:
    if named:
        return Path(named)
    if services := os.environ.get(IDENTITY):
        own = Path(services) / HLI
        return own if own.is_dir() else Path(services)
    return None
