"""A client's identity, for clients that do not always have the package that reads certificates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deltaq_protocol.certified.names import IdentityError

if TYPE_CHECKING:
    from deltaq_protocol.certified.signed import IdentityProver


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
