"""A request of an operator or controller, signed with their identity in answer to the server's challenge.

A signed proof is `length (2 bytes) | signature | length (2) | nonce | certificate (DER)` and travels where a proof with
a token would (`deltaq_protocol.proof`), which is never as long. The signature is ECDSA with SHA-256 over the words
`deltaq client`, then nonce, zenoh key and message, each behind its length in eight bytes; all numbers are big-endian.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from deltaq_protocol.certified.certificate import now_utc
from deltaq_protocol.certified.identity import Identity
from deltaq_protocol.certified.names import IdentityError, IdentityKind
from deltaq_protocol.proof import MAX_PROOF_BYTES

MAX_SIGNED_BYTES = 2048
_LENGTH_BYTES = 2
_CONTEXT = b"deltaq client"
_ALGORITHM = ec.ECDSA(hashes.SHA256())
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Signed:
    """The parts of a signed proof, none of them looked at yet."""

    signature: bytes
    nonce: bytes
    certificate: bytes

    @classmethod
    def parse(cls, proof: bytes) -> Signed | None:
        """Read a signature from the attachment of a message; None if the attachment is no signature."""
        if not MAX_PROOF_BYTES < len(proof) <= MAX_SIGNED_BYTES:
            return None
        parts, rest = [], proof
        for _ in range(2):
            length = int.from_bytes(rest[:_LENGTH_BYTES], "big")
            parts.append(rest[_LENGTH_BYTES : _LENGTH_BYTES + length])
            rest = rest[_LENGTH_BYTES + length :]
        return cls(parts[0], parts[1], rest) if rest else None

    def is_of(self, public_key: ec.EllipticCurvePublicKey, key: str, message: bytes) -> bool:
        """Whether the owner of a key signed this for a message under a zenoh key."""
        try:
            public_key.verify(self.signature, _text(self.nonce, key, message), _ALGORITHM)
        except InvalidSignature:
            return False
        return True

    def pack(self) -> bytes:
        """The bytes to send."""
        parts = (self.signature, self.nonce)
        return b"".join(len(part).to_bytes(_LENGTH_BYTES, "big") + part for part in parts) + self.certificate


class IdentityProver:
    """Signs requests.

    Args:
        folder: of the identity of an operator or controller.

    Raises:
        IdentityError: if there is none, it is not valid, or that of a service.
    """

    def __init__(self, folder: Path) -> None:
        identity = Identity.read(folder, now_utc())
        if identity.kind is IdentityKind.SERVICE:
            raise IdentityError(
                f"{folder} is the identity of {identity.name}, a service; clients have that of an operator or a "
                "controller, which `deltaq keys --operator NAME` and `--controller NAME` make"
            )
        if warning := identity.warning(now_utc()):
            _log.warning(warning)
        self._key = identity.key
        self._certificate = identity.certificate.public_bytes(Encoding.DER)

    def prove(self, key: str, message: bytes, nonce: bytes) -> bytes:
        """A signed proof for a message under a zenoh key, in answer to a challenge."""
        signature = self._key.sign(_text(nonce, key, message), _ALGORITHM)
        return Signed(signature, nonce, self._certificate).pack()


def _text(nonce: bytes, key: str, message: bytes) -> bytes:
    parts = (nonce, key.encode(), message)
    return _CONTEXT + b"".join(len(part).to_bytes(8, "big") + part for part in parts)
