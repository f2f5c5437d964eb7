"""Proofs that the sender of a message knows a secret: a lease's, or the operator's. The secret itself is not sent.

A proof is `MAC (32 bytes) | nonce` and travels beside the message, as the attachment of the zenoh sample or query. The
MAC is BLAKE2b (RFC 7693, 2.9) over the length of the nonce in eight bytes, the nonce, the length of the zenoh key in
eight bytes, that key, and the message as it was sent; its key is the BLAKE2b hash of the secret, 32 bytes long. All
numbers are big-endian. So a proof of one message is not valid for another.

The nonce says why the message is new:

- a request for a lease or for outputs has a count, eight bytes, which grows with each request under a lease;
- a request of the operator has the challenge that the server gave for it;
- an increment has none: its sequence number grows.
"""

import functools
import hmac
import itertools
from hashlib import blake2b
from hmac import compare_digest

MAC_BYTES = 32
COUNT_BYTES = 8
MAX_PROOF_BYTES = 128
"""Longest proof, some more than a challenge needs."""
_LENGTH_BYTES = 8


class Prover:
    """Makes proofs with one secret; callable from any thread.

    Args:
        secret: a lease's, as its reply has it, or the operator's token.
    """

    def __init__(self, secret: str) -> None:
        self._key = key_of(secret)
        self._counts = itertools.count(1)

    def prove(self, key: str, message: bytes, nonce: bytes = b"") -> bytes:
        """A proof for a message under a zenoh key."""
        return _mac(self._key, nonce, key, message) + nonce

    def prove_next(self, key: str, message: bytes) -> bytes:
        """A proof for a request, with the next count."""
        return self.prove(key, message, next(self._counts).to_bytes(COUNT_BYTES, "big"))


def line_proof(token: str, challenge: str) -> str:
    """The proof in the hello of a TCP client: HMAC-SHA256 (RFC 2104), in hexadecimal digits.

    Args:
        token: of a role; it is not sent.
        challenge: the server's challenge, in hexadecimal digits.
    """
    return hmac.new(token.encode(), f"deltaq hello {challenge}".encode(), "sha256").hexdigest()


@functools.lru_cache(maxsize=64)
def key_of(secret: str) -> bytes:
    """The MAC's key; JSON can bring half a surrogate pair into a secret, which cannot be encoded."""
    return blake2b(secret.encode(errors="replace"), digest_size=MAC_BYTES).digest()


def proven_nonce(mac_key: bytes, key: str, message: bytes, proof: bytes) -> bytes | None:
    """The nonce of a valid proof; None for any other. Compared in constant time.

    Args:
        mac_key: of the secret, by `key_of`.
        key: zenoh key under which the message came.
        message: its bytes.
        proof: its attachment.
    """
    if not MAC_BYTES <= len(proof) <= MAX_PROOF_BYTES:
        return None
    nonce = proof[MAC_BYTES:]
    return nonce if compare_digest(_mac(mac_key, nonce, key, message), proof[:MAC_BYTES]) else None


def _mac(mac_key: bytes, nonce: bytes, key: str, message: bytes) -> bytes:
    name = key.encode()
    lengths = len(nonce).to_bytes(_LENGTH_BYTES, "big"), len(name).to_bytes(_LENGTH_BYTES, "big")
    return blake2b(
        b"".join((lengths[0], nonce, lengths[1], name, message)), digest_size=MAC_BYTES, key=mac_key
    ).digest()
