"""Proofs of a client's role, by its identity or its token, neither of which is sent."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from deltaq_protocol.certified.names import CLIENT_IDENTITY, IdentityError
from deltaq_protocol.given_token import CLIENT_TOKEN, given_token
from deltaq_protocol.proof import Prover

if TYPE_CHECKING:
    from deltaq_protocol.certified.signed import IdentityProver


# A client's identity, for clients that do not always have the package that reads certificates.


def identity_prover(folder: Path) -> IdentityProver:
    """The signer of a client's requests.

    Raises:
        IdentityError: there is no identity, it is not valid or a service's, or `cryptography` is not installed.
    """
    try:
        from deltaq_protocol.certified.signed import IdentityProver
    except ModuleNotFoundError as error:
        raise IdentityError(
            f"{folder} cannot be read: {error.name} is not installed; `pip install 'deltaq[identity]'`"
        ) from error
    return IdentityProver(folder)


class RoleProver(Protocol):
    """Shows a client's role, and with an identity its name."""

    def prove(self, key: str, message: bytes, nonce: bytes) -> bytes:
        """A proof for a message under a zenoh key, in answer to a challenge."""


class RoleOfEnvironment:
    """Shows the role that the environment names, which is read when a role is needed: a stop needs none."""

    def prove(self, key: str, message: bytes, nonce: bytes) -> bytes:
        """A proof, as `RoleProver` has it.

        Raises:
            IdentityError: the identity is missing, not valid, or a service's.
            GivenTokenError: the file of the token cannot be read, or is no secret.
        """
        return self._prover.prove(key, message, nonce)

    @cached_property
    def _prover(self) -> RoleProver:
        folder = os.environ.get(CLIENT_IDENTITY)
        return identity_prover(Path(folder)) if folder else Prover(given_token(CLIENT_TOKEN) or "")


def role_prover(token: str | None, identity: str | os.PathLike[str] | None) -> RoleProver | None:
    """The prover of a client's role, from its program or the environment; None: the client has no role to prove.

    Raises:
        IdentityError: the identity that the program names is missing, not valid, or a service's.
    """
    if identity:
        return identity_prover(Path(identity))
    if token and not os.environ.get(CLIENT_IDENTITY):
        return Prover(token)
    return RoleOfEnvironment() if environment_has_role(os.environ) else None


def environment_has_role(environment: Mapping[str, str]) -> bool:
    """Whether an environment names an identity or a token that its clients show."""
    return any(map(environment.get, (CLIENT_IDENTITY, CLIENT_TOKEN, f"{CLIENT_TOKEN}_FILE")))
