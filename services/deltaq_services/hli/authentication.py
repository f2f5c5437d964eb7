"""Who a zenoh message is from, as far as it proves it: the holder of a lease, or the operator.

Plain decisions; the shell passes the time in. What is not proven is not decoded.
"""

from __future__ import annotations

from typing import NamedTuple

from deltaq_protocol.codec import MAX_MESSAGE_BYTES
from deltaq_protocol.proof import key_of, proven_nonce
from deltaq_services.hli.challenges import Challenges
from deltaq_services.hli.leases import Leases


class Proven(NamedTuple):
    """The token of a lease, and whether it is the present one."""

    token: str
    is_present: bool


class Authentication:
    """Checks proofs.

    Args:
        leases: whose secrets may have proven something.
        operator_token: the operator's; None where there is no operator.
        secret: that challenges are made with, different each time.
    """

    def __init__(self, leases: Leases, operator_token: str | None, secret: str) -> None:
        self._leases = leases
        self._operator_key = None if operator_token is None else key_of(operator_token)
        self._operator_token = operator_token
        self._challenges = Challenges(secret)
        self._counts: dict[str, tuple[str, int]] = {}

    def holder_of_increment(self, robot: str, key: str, message: bytes, proof: bytes) -> Proven | None:
        """Under which lease an increment was sent: the present one, or the one before it; any thread may ask.

        One of the lease before comes from a holder that has not heard of its loss yet, and is to be told.
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

    def is_known(self, key: str, message: bytes, proof: bytes) -> bool:
        """Whether any holder or the operator made a request, new or not; any thread may ask."""
        if len(message) > MAX_MESSAGE_BYTES:
            return False
        keys = [key_of(token) for token in self._leases.tokens()]
        if self._operator_key is not None:
            keys.append(self._operator_key)
        return any(proven_nonce(mac_key, key, message, proof) is not None for mac_key in keys)

    def challenge(self, time_s: float) -> bytes:
        """A challenge for the operator's next request; any thread may ask."""
        return self._challenges.new(time_s)

    def operator(self, key: str, message: bytes, proof: bytes, time_s: float) -> str | None:
        """The operator's token, if the operator made a request, in answer to a challenge that is not used yet."""
        if self._operator_key is None or len(message) > MAX_MESSAGE_BYTES:
            return None
        nonce = proven_nonce(self._operator_key, key, message, proof)
        if not nonce or not self._challenges.accept(nonce, time_s):
            return None
        return self._operator_token
