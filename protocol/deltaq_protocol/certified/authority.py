"""The authority of a cell: it issues the identities of its services, operators and controllers.

authority/key.pem, certificate.pem    whoever has the key can make identities
authority/issued/NAME.pem             the certificate of each identity that was made
NAME/...                              one folder an identity, see `deltaq_protocol.certified.identity`
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from deltaq_protocol.certified.certificate import (
    cell_in,
    certificate_in,
    check_authority,
    check_issued,
    name_in,
    public_key_of,
)
from deltaq_protocol.certified.identity import private_key_in, read_believed
from deltaq_protocol.certified.names import (
    AUTHORITY,
    CERTIFICATE,
    KEY,
    IdentityError,
    IdentityKind,
    kind_of,
)

FOLDER = "authority"
ISSUED = "issued"
LIFETIME = timedelta(days=730)
_AUTHORITY_LIFETIME = timedelta(days=3650)
_EARLIER = timedelta(days=1)
"""A certificate is valid from before it was made: clocks of machines differ."""


@dataclass(frozen=True)
class Made:
    """The result of `make_identities`.

    Attributes:
        authority: its folder.
        is_new: the authority was made too.
        made: names of the identities that were made.
        kept: names of identities that it had made earlier.
        valid_until: end of the validity of the new certificates.
    """

    authority: Path
    is_new: bool
    made: tuple[str, ...]
    kept: tuple[str, ...]
    valid_until: datetime


class Authority:
    """Issues certificates.

    Args:
        key: the authority's.
        certificate: of that key, signed with it.
    """

    def __init__(self, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
        self._key = key
        self.certificate = certificate

    @classmethod
    def new(cls, cell: str, now: datetime) -> Authority:
        """Another one for a cell."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(cell, "authority")
        builder = (
            _builder(name, name, key, now, now + _AUTHORITY_LIFETIME)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        )
        return cls(key, builder.sign(key, hashes.SHA256()))

    @classmethod
    def read(cls, folder: Path, now: datetime) -> Authority:
        """The authority in a folder.

        Raises:
            IdentityError: if there is none, or other users may read or write it.
        """
        key = private_key_in(folder / KEY)
        file = folder / CERTIFICATE
        certificate = certificate_in(read_believed(file), str(file))
        check_authority(certificate, str(file), now)
        if public_key_of(certificate) != key.public_key():
            raise IdentityError(f"{file} is not of the key beside it; copy whole folders")
        return cls(key, certificate)

    def issue(
        self, name: str, now: datetime, lifetime: timedelta = LIFETIME
    ) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
        """A key and its certificate, for a new identity."""
        key = ec.generate_private_key(ec.SECP256R1())
        subject = _name(cell_in(self.certificate), name)
        end = self.end_of(now, lifetime)
        issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())
        is_service = kind_of(name) is IdentityKind.SERVICE
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if is_service else [])]
        builder = (
            _builder(subject, self.certificate.subject, key, now, end)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .add_extension(issuer, critical=False)
        )
        return key, builder.sign(self._key, hashes.SHA256())

    def end_of(self, now: datetime, lifetime: timedelta) -> datetime:
        """Until when it lets a certificate of now be valid: no longer than its own."""
        return min(now + lifetime, self.certificate.not_valid_after_utc)

    def write(self, folder: Path) -> None:
        """Write it to a new folder."""
        with _made_whole(folder) as unfinished:
            _write_key(unfinished / KEY, self._key)
            _write_certificate(unfinished / CERTIFICATE, self.certificate)
            (unfinished / ISSUED).mkdir(mode=0o700)


def make_identities(
    cell: str,
    to: Path,
    services: Sequence[str],
    people: Iterable[str],
    now: datetime,
    authority: Path | None = None,
    lifetime: timedelta = LIFETIME,
) -> Made:
    """Make the identities that a cell's authority has not made yet, and the authority if there is none.

    Args:
        cell: name of the cell.
        to: folder that gets one folder for each identity.
        services: names of the cell's services.
        people: names of its operators and controllers, as `names.name_of` has them.
        now: beginning of their validity.
        authority: folder of the authority, if it is not `authority` in `to`.
        lifetime: of a new certificate.

    Raises:
        IdentityError: the authority's key is missing or of another cell, or one of the names has an identity
            already. Nothing is ever overwritten.
    """
    place = to / FOLDER if authority is None else authority
    is_new = authority is None and not place.exists()
    try:
        to.mkdir(mode=0o700, parents=True, exist_ok=True)
        if is_new:
            _refuse_to_replace(to, services)
            Authority.new(cell, now).write(place)
        issuing = Authority.read(place, now)
        if (theirs := cell_in(issuing.certificate)) != cell:
            raise IdentityError(
                f"{place} is the authority of cell {theirs}, not of {cell}; name another folder"
            )
        known = {name: _issued(place, name, issuing, now) for name in (*services, *people)}
        made = {name: issuing.issue(name, now, lifetime) for name, old in known.items() if old is None}
        if taken := [name for name in made if (to / name).exists()]:
            raise IdentityError(
                f"{to / taken[0]} exists already, and this authority has not made it; remove it, or name another --to"
            )
        for name, (key, certificate) in made.items():
            with _made_whole(to / name) as unfinished:
                _write_key(unfinished / KEY, key)
                _write_certificate(unfinished / CERTIFICATE, certificate)
                _write_certificate(unfinished / AUTHORITY, issuing.certificate)
            _write_certificate(place / ISSUED / f"{name}.pem", certificate)
    except OSError as error:
        raise IdentityError(f"{error.filename} cannot be written: {error.strerror}") from error
    kept = tuple(name for name in known if name not in made)
    return Made(place, is_new, tuple(made), kept, issuing.end_of(now, lifetime))


def _refuse_to_replace(to: Path, services: Sequence[str]) -> None:
    """Identities whose authority is elsewhere get no second one."""
    if present := [name for name in services if (to / name).exists()]:
        raise IdentityError(
            f"{to} has {', '.join(present)}, and no {FOLDER}; name the folder with their authority's key with "
            "--authority, or another --to"
        )


def _issued(place: Path, name: str, issuing: Authority, now: datetime) -> x509.Certificate | None:
    """The certificate that an authority has issued under a name; None if there is none."""
    file = place / ISSUED / f"{name}.pem"
    if not file.exists():
        return None
    certificate = certificate_in(read_believed(file), str(file))
    check_issued(certificate, issuing.certificate, str(file), now)
    if name_in(certificate) != name:
        raise IdentityError(f"{file} is the certificate of {name_in(certificate)}; copy whole folders")
    return certificate


@contextmanager
def _made_whole(folder: Path) -> Iterator[Path]:
    """A folder that is there with all that the block writes to it, or not at all."""
    unfinished = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield unfinished
        unfinished.rename(folder)
    except BaseException:
        shutil.rmtree(unfinished)
        raise


def _write_key(file: Path, key: ec.EllipticCurvePrivateKey) -> None:
    _write(file, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), 0o600)


def _write_certificate(file: Path, certificate: x509.Certificate) -> None:
    _write(file, certificate.public_bytes(Encoding.PEM), 0o644)


def _write(file: Path, data: bytes, mode: int) -> None:
    with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as opened:
        opened.write(data)


def _name(cell: str, name: str) -> x509.Name:
    return x509.Name(
        [x509.NameAttribute(NameOID.ORGANIZATION_NAME, cell), x509.NameAttribute(NameOID.COMMON_NAME, name)]
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, begin: datetime, end: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin - _EARLIER)
        .not_valid_after(end)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_agreement=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        encipher_only=False,
        decipher_only=False,
    )
