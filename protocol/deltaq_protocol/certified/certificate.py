"""Certificates of a cell (X.509, ECDSA with P-256): read, and believed only from their authority, in their time."""

from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from deltaq_protocol.certified.names import IdentityError

RENEW_BEFORE = timedelta(days=30)
"""Left of a certificate's time when its user begins to be warned."""
_ALL_BITS_USED = b"\0"
RENEW = "make new ones with `deltaq keys --cell CELL --output NEW_FOLDER`, and give each machine its own"


def certificate_in(pem: bytes, where: str) -> x509.Certificate:
    """The certificate in a file's bytes.

    Raises:
        IdentityError: if there is none, or its key is of another kind than those of cells.
    """
    try:
        certificate = x509.load_pem_x509_certificate(pem)
        key = certificate.public_key()
    except ValueError as error:
        raise IdentityError(f"{where} holds no certificate; `deltaq keys` makes them") from error
    if not (isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, ec.SECP256R1)):
        raise IdentityError(f"{where}: its key is not of the curve P-256; `deltaq keys` makes those that are")
    return certificate


def public_key_of(certificate: x509.Certificate) -> ec.EllipticCurvePublicKey:
    """The key of a certificate that `certificate_in` has read."""
    key = certificate.public_key()
    assert isinstance(key, ec.EllipticCurvePublicKey)  # or it was refused
    return key


def name_in(certificate: x509.Certificate) -> str:
    """Its owner: the common name."""
    return _subject(certificate, NameOID.COMMON_NAME)


def cell_in(certificate: x509.Certificate) -> str:
    """Of which cell it is: its organization."""
    return _subject(certificate, NameOID.ORGANIZATION_NAME)


def check_authority(authority: x509.Certificate, where: str, now: datetime) -> None:
    """Check that a certificate is that of an authority, signed by itself.

    Raises:
        IdentityError: if it is not, or out of date.
    """
    try:
        constraints = authority.extensions.get_extension_for_class(x509.BasicConstraints).value
        is_authority = constraints.ca
    except (x509.ExtensionNotFound, ValueError):
        is_authority = False
    if not is_authority or not _is_issued_by(authority, authority):
        raise IdentityError(
            f"{where} is not the certificate of an authority; `deltaq keys` makes one for a cell"
        )
    check_time(authority, where, now)


def check_issued(
    certificate: x509.Certificate, authority: x509.Certificate, where: str, now: datetime
) -> None:
    """Check that an authority issued a certificate, and that it is in its time.

    Raises:
        IdentityError: if not.
    """
    if not _is_issued_by(certificate, authority):
        raise IdentityError(
            f"{where} was not issued by the authority of cell {cell_in(authority)} that lies beside it; all "
            "identities of a cell come from one `deltaq keys`"
        )
    check_time(certificate, where, now)


def check_time(certificate: x509.Certificate, where: str, now: datetime) -> None:
    """Check that a certificate is valid by now.

    Raises:
        IdentityError: if it is not yet, or no more.
    """
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now < begin:
        raise IdentityError(
            f"{where} is valid from {begin:%Y-%m-%d %H:%M} UTC, and this machine's clock says {now:%Y-%m-%d %H:%M}; "
            "set the clock"
        )
    if now > end:
        raise IdentityError(
            f"{where} was valid until {end:%Y-%m-%d %H:%M} UTC, and this machine's clock says {now:%Y-%m-%d %H:%M}; "
            f"{RENEW}, or set the clock if it is wrong"
        )


def days_left(certificate: x509.Certificate, now: datetime) -> int:
    """Whole days until a certificate's end."""
    return (certificate.not_valid_after_utc - now).days


def now_utc() -> datetime:
    """This machine's time."""
    return datetime.now(UTC)


def _is_issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, ValueError, TypeError):
        return False
    # a bit string may leave bits of its last byte unused (X.690, 8.6.2), so that other bytes could mean the same
    return certificate.public_bytes(Encoding.DER).endswith(_ALL_BITS_USED + certificate.signature)


def _subject(certificate: x509.Certificate, what: x509.ObjectIdentifier) -> str:
    values = certificate.subject.get_attributes_for_oid(what)
    value = values[0].value if len(values) == 1 else ""
    return value if isinstance(value, str) else ""
