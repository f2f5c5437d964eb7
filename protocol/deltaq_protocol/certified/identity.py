"""An identity in its folder: own key and certificate, and the authority's certificate.

key.pem             own key; its owner's secret
certificate.pem     who this is, signed by the authority of the cell
authority.pem       the authority's certificate
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from deltaq_protocol.certified.certificate import (
    RENEW,
    RENEW_BEFORE,
    cell_in,
    certificate_in,
    check_authority,
    check_issued,
    days_left,
    name_in,
    public_key_of,
)
from deltaq_protocol.certified.names import (
    AUTHORITY,
    CERTIFICATE,
    KEY,
    IdentityError,
    IdentityKind,
    kind_of,
)
from deltaq_protocol.secret_file import contents, faults_of_believed, faults_of_secret

_MAKES = "deltaq keys --cell CELL --output FOLDER"


@dataclass(frozen=True)
class Identity:
    """The identity of a service, operator or controller: its certificate and its private key.

    Attributes:
        folder: folder from which it was read.
        key: its own.
        certificate: the certificate of that key.
        authority: certificate of its issuer.
    """

    folder: Path
    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate
    authority: x509.Certificate

    @classmethod
    def read(cls, folder: Path, now: datetime) -> Identity:
        """The identity in a folder.

        Raises:
            IdentityError: if there is none, other users may read or write it, or its authority's certificate is not
                valid now.
        """
        files = {name: folder / name for name in (KEY, CERTIFICATE, AUTHORITY)}
        key = private_key_in(files[KEY])
        authority = certificate_in(read_believed(files[AUTHORITY]), str(files[AUTHORITY]))
        check_authority(authority, str(files[AUTHORITY]), now)
        certificate = certificate_in(read_believed(files[CERTIFICATE]), str(files[CERTIFICATE]))
        check_issued(certificate, authority, str(files[CERTIFICATE]), now)
        if public_key_of(certificate) != key.public_key():
            raise IdentityError(f"{files[CERTIFICATE]} is not of the key {files[KEY]}; copy whole folders")
        return cls(folder, key, certificate, authority)

    @property
    def name(self) -> str:
        """Its common name, e.g. `robot-server-fr` or `operator-desk`."""
        return name_in(self.certificate)

    @property
    def kind(self) -> IdentityKind:
        """The kind of its owner."""
        return kind_of(self.name)

    @property
    def cell(self) -> str:
        """Name of the cell that it is of."""
        return cell_in(self.authority)

    def warning(self, now: datetime) -> str | None:
        """The notice about a certificate that expires soon; None while there is time."""
        left = days_left(self.certificate, now)
        if left >= RENEW_BEFORE.days:
            return None
        end = f"{self.certificate.not_valid_after_utc:%Y-%m-%d}"
        return f"{self.folder / CERTIFICATE} is valid for {left} more days, until {end}; {RENEW}"


def private_key_in(file: Path) -> ec.EllipticCurvePrivateKey:
    """The private key in a file that only this user can read.

    Raises:
        IdentityError: if it is not, or there is none.
    """
    about, pem = _contents(file)
    if faults := faults_of_secret(about, file, _MAKES):
        raise IdentityError(f"{file} {faults[0]}")
    try:
        key = load_pem_private_key(pem, password=None)
    except (ValueError, TypeError) as error:  # never shown
        raise IdentityError(f"{file} holds no key; `{_MAKES}` makes one") from error
    if not (isinstance(key, ec.EllipticCurvePrivateKey) and isinstance(key.curve, ec.SECP256R1)):
        raise IdentityError(f"{file}: the key is not of the curve P-256; `{_MAKES}` makes one that is")
    return key


def read_believed(file: Path) -> bytes:
    """The bytes of a file that no other user can write.

    Raises:
        IdentityError: if another user can write it, or it cannot be read.
    """
    about, data = _contents(file)
    if faults := faults_of_believed(about, file):
        raise IdentityError(f"{file} {faults[0]}")
    return data


def _contents(file: Path) -> tuple[os.stat_result, bytes]:
    try:
        return contents(file)
    except OSError as error:
        raise IdentityError(
            f"{file} cannot be read: {error.strerror}; `{_MAKES}` makes identities"
        ) from error
