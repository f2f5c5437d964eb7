"""Authentication of zenoh messages: the proven sender is the holder of a lease or has the token of a role.

Pure: the shell passes the time. Messages without a proof are not decoded.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable
from datetime import datetime
from hashlib import blake2b
from hmac import compare_digest
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from deltaq_protocol.certified.certificate import check_issued, name_in
from deltaq_protocol.certified.names import person_named
from deltaq_protocol.certified.signed import Signed
from deltaq_protocol.codec import MAX_MESSAGE_BYTES
from deltaq_protocol.proof import MAX_PROOF_BYTES, key_of, line_proof, proven_nonce
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.leases import Leases, Sequence

# Challenges that a request of the operator answers, each good once and not for long.
#
# They are not stored: the server recognizes its own by their MAC, so a client that asks for a million displaces no
# other's. Used ones are remembered while they would be valid; only a client with the operator's token can use one.

GOOD_FOR_S = 5.0
"""Between the challenge and the request lies one round trip."""

_MADE = struct.Struct(">dQ")
_MAC_BYTES = 32


class Challenges:
    """Makes challenges, and recognises its own.

    Args:
        secret: different in each process.
    """

    def __init__(self, secret: str) -> None:
        self._key = blake2b(secret.encode(), digest_size=_MAC_BYTES).digest()
        self._counts = itertools.count(1)
        self._used: dict[bytes, float] = {}

    def new(self, time_s: float) -> bytes:
        """Make a new, unique challenge; callable from any thread."""
        made = _MADE.pack(time_s, next(self._counts))
        return made + self._mac(made)

    def accept(self, challenge: bytes, time_s: float) -> bool:
        """Whether a challenge is one of this process's, fresh, and was never accepted before."""
        self._used = {used: until_s for used, until_s in self._used.items() if time_s <= until_s}
        if not self.is_new(challenge, time_s):
            return False
        self._used[challenge] = _until_s(challenge)
        return True

    def is_new(self, challenge: bytes, time_s: float) -> bool:
        """Whether `accept` would accept a challenge; nothing is accepted, and any thread may ask."""
        made = challenge[: _MADE.size]
        is_own = len(made) == _MADE.size and compare_digest(self._mac(made), challenge[_MADE.size :])
        return is_own and time_s <= _until_s(challenge) and challenge not in self._used

    def _mac(self, made: bytes) -> bytes:
        return blake2b(made, digest_size=_MAC_BYTES, key=self._key).digest()


def _until_s(challenge: bytes) -> float:
    made_s: float = _MADE.unpack(challenge[: _MADE.size])[0]
    return made_s + GOOD_FOR_S


# Operators and controllers by their certificates: the name of a request's sender. The shell passes the clock.

_MOST_KNOWN = 256
"""Certificates that are not verified again each time."""


class ClientIdentities:
    """Recognizes clients by certificates of the cell's authority.

    Args:
        authority: its certificate.
        now: this machine's time.
    """

    def __init__(self, authority: x509.Certificate, now: Callable[[], datetime]) -> None:
        self._authority = authority
        self._now = now
        self._known: dict[bytes, x509.Certificate] = {}

    def nonce(self, proof: bytes) -> bytes:
        """The challenge that a signed proof claims to answer; empty for any other proof."""
        signed = Signed.parse(proof)
        return b"" if signed is None else signed.nonce

    def name(self, key: str, message: bytes, proof: bytes) -> str:
        """The identity that signed a message under a zenoh key, e.g. `operator-desk`; empty if no permitted one did.

        Callable from any thread. It does not check whether the challenge is new.
        """
        signed = Signed.parse(proof)
        if signed is None:
            return ""
        try:
            certificate = self._believed(signed)
        except Exception:  # forged certificates raise errors of many unrelated types
            return ""
        public_key = certificate.public_key()
        if not (isinstance(public_key, ec.EllipticCurvePublicKey) and signed.is_of(public_key, key, message)):
            return ""
        return person_named(name_in(certificate))

    def _believed(self, signed: Signed) -> x509.Certificate:
        """The certificate, if the authority issued it and it is valid now; raises an error of any type otherwise."""
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


_TOLD_APART = 64
"""Newest requests of a lease: such as overtake one another are all new."""


class Proven(NamedTuple):
    """The token of a lease, and whether it is the present one."""

    token: str
    is_present: bool


class Authentication:
    """Checks proofs.

    Args:
        leases: the leases, whose secrets proofs are made with.
        roles: the roles, whose tokens proofs are made with.
        secret: the secret of this process's challenges, new for each process.
        identities: judges certificates and their signatures; None: certificates prove nothing.
    """

    def __init__(
        self, leases: Leases, roles: ClientRoles, secret: str, identities: ClientIdentities | None = None
    ) -> None:
        self._identities = identities
        self._leases = leases
        self._roles = roles
        self._challenges = Challenges(secret)
        # messages from zenoh's threads that the loop has not taken yet
        self._heard_challenges = Challenges(secret)
        self._heard_counts: dict[str, Sequence] = {}
        self._counts: dict[str, tuple[str, int]] = {}

    def holder_of_increment(self, robot: str, key: str, message: bytes, proof: bytes) -> Proven | None:
        """The lease under which an increment was sent: the present or the previous one; callable from any thread.

        An increment under the previous lease comes from a holder that does not know of its loss yet; it must get an
        answer.
        """
        if len(message) > MAX_MESSAGE_BYTES:
            return None
        present, ended = self._leases.newest_tokens(robot)
        for token in (present, ended):
            if token is not None and proven_nonce(key_of(token), key, message, proof) == b"":
                return Proven(token, token == present)
        return None

    def holder(self, robot: str, key: str, message: bytes, proof: bytes) -> str | None:
        """Token of the lease whose holder made a request, if it is a new one."""
        lease = self._leases.of(robot)
        if lease is None or len(message) > MAX_MESSAGE_BYTES:
            return None
        nonce = proven_nonce(key_of(lease.token), key, message, proof)
        if not nonce:
            return None
        token, count = self._counts.get(robot, ("", 0))
        newest = count if token == lease.token else 0
        if (asked := int.from_bytes(nonce, "big")) <= newest:
            return None
        self._counts[robot] = lease.token, asked
        return lease.token

    def goes_first(self, key: str, message: bytes, proof: bytes, time_s: float) -> bool:
        """Whether a holder, or a client with a role, made a request that is no duplicate; one thread at a time may ask.

        A replayed proof proves nothing, and its request waits among unproven ones.
        """
        if len(message) > MAX_MESSAGE_BYTES:
            return False
        if len(proof) > MAX_PROOF_BYTES:
            name, signed = self._signer(key, message, proof, self._heard_challenges, time_s)
            return bool(name) and self._heard_challenges.accept(signed, time_s)
        holders = self._leases.tokens()
        self._heard_counts = {
            token: self._heard_counts.get(token, Sequence(_TOLD_APART)) for token in holders
        }
        for token in holders:
            nonce = proven_nonce(key_of(token), key, message, proof)
            if nonce is not None:
                return self._heard_counts[token].take(int.from_bytes(nonce, "big"))
        for token in self._roles.tokens:
            nonce = proven_nonce(key_of(token), key, message, proof)
            if nonce is not None:
                return self._heard_challenges.accept(nonce, time_s)
        return False

    def challenge(self, time_s: float) -> bytes:
        """A challenge for the next request with a token; any thread may ask."""
        return self._challenges.new(time_s)

    def token(self, key: str, message: bytes, proof: bytes, time_s: float) -> str | None:
        """The token of a role that a request proves, in answer to a challenge that is not used yet."""
        if len(message) > MAX_MESSAGE_BYTES:
            return None
        for token in self._roles.tokens:
            nonce = proven_nonce(key_of(token), key, message, proof)
            if nonce and self._challenges.accept(nonce, time_s):
                return token
        return None

    def token_of_line(self, challenge: str, proof: str, time_s: float) -> str | None:
        """The token of a role that a hello over TCP proves, in answer to a challenge that is not used yet."""
        for token in self._roles.tokens:
            if compare_digest(line_proof(token, challenge), proof):
                return token if self._challenges.accept(bytes.fromhex(challenge), time_s) else None
        return None

    def identity(self, key: str, message: bytes, proof: bytes, time_s: float) -> str:
        """Under which name a request was signed, in answer to a challenge that is not used yet; empty: none."""
        if len(message) > MAX_MESSAGE_BYTES:
            return ""
        name, nonce = self._signer(key, message, proof, self._challenges, time_s)
        return name if name and self._challenges.accept(nonce, time_s) else ""

    def _signer(
        self, key: str, message: bytes, proof: bytes, challenges: Challenges, time_s: float
    ) -> tuple[str, bytes]:
        """Who signed a request, and the challenge that it answers.

        A signature takes a hundred times as long to look at as a MAC, so the challenge's comes first.
        """
        if self._identities is None:
            return "", b""
        nonce, name = self._identities.nonce(proof), ""
        if challenges.is_new(nonce, time_s):
            name = self._identities.name(key, message, proof)
        return name, nonce
