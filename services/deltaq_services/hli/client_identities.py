"""Operators and controllers by their certificates: who made a request, by name. The shell passes the clock in."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from deltaq_protocol.certified.certificate import check_issued, name_in
from deltaq_protocol.certified.names import person_named
from deltaq_protocol.certified.signed import Signed

_MOST_KNOWN = 256
"""Certificates that are not verified again each time."""


class ClientIdentities:
    """Knows those to whom a cell's authority gave a certificate.

    Args:
        authority: its certificate.
        now: this machine's time.
    """

    def __init__(self, authority: x509.Certificate, now: Callable[[], datetime]) -> None:
        self._authority = authority
        self._now = now
        self._known: dict[bytes, x509.Certificate] = {}

    def nonce(self, proof: bytes) -> bytes:
        """The challenge that a signed proof says it answers; empty if it is none."""
        signed = Signed.parse(proof)
        return b"" if signed is None else signed.nonce

    def name(self, key: str, message: bytes, proof: bytes) -> str:
        """The identity that signed a message under a zenoh key, e.g. `operator-desk`; empty if no permitted one did.

        Any thread may ask. Whether the challenge is new is another question.
        """
        signed = Signed.parse(proof)
        if signed is None:
            return ""
        try:
            certificate = self._believed(signed)
        except Exception:  # what strangers make up raises many unrelated types
            return ""
        public_key = certificate.public_key()
        if not (isinstance(public_key, ec.EllipticCurvePublicKey) and signed.is_of(public_key, key, message)):
            return ""
        return person_named(name_in(certificate))

    def _believed(self, signed: Signed) -> x509.Certificate:
        """Its certificate, which the authority issued for now; an error of whatever type if it did not."""
        known = self._known.get(signed.certificate)
        now = self._now()
        if known is not None and now <= known.not_valid_after_utc:
            return known
        certificate = x509.load_der_x509_certificate(signed.certificate)
        check_issued(certificate, self._authority, "a client's certificate", now)
        if len(self._known) >= _MOST_KNOWN:
            self._known.clear()
        self._known[signed.certificate] = certificate
        return certificate
