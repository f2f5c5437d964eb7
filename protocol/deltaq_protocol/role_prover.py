"""What shows the server a client's role: its identity or its token, neither of which is sent."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol

from deltaq_protocol.certified.names import CLIENT_IDENTITY
from deltaq_protocol.certified.prover import identity_prover
from deltaq_protocol.given_token import CLIENT_TOKEN, given_token
from deltaq_protocol.proof import Prover


class RoleProver(Protocol):
    """Shows a client's role, and with an identity its name."""

    def prove(self, key: str, message: bytes, nonce: bytes) -> bytes:
        """A proof for a message under a zenoh key, in answer to a challenge."""


def role_prover(token: str | None, identity: str | os.PathLike[str] | None) -> RoleProver | None:
    """What shows the role of a client, which its program or the environment names; None: nothing does.

    Raises:
        IdentityError: the identity is missing, not valid, or a service's.
        GivenTokenError: the file of the token cannot be read, or is no secret.
    """
    if folder := identity or os.environ.get(CLIENT_IDENTITY):
        return identity_prover(Path(folder))
    known = token or given_token(CLIENT_TOKEN)
    return Prover(known) if known else None
