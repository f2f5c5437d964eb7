"""What an identity is, by its name: a service's own, `operator-NAME` or `controller-NAME`."""

import re
from enum import StrEnum

from deltaq_protocol.errors import DeltaqError

IDENTITY = "DELTAQ_IDENTITY"
"""Environment variable: the folder of an identity, or one in which each service of this machine has its own."""
AUTHORITY_FILE = "DELTAQ_CLIENT_AUTHORITY_FILE"
"""Environment variable: certificate of the authority of clients' identities, for an HLI without an identity."""
CLIENT_IDENTITY = "DELTAQ_CLIENT_IDENTITY"
"""Environment variable: the folder of an operator's or a controller's identity, for clients."""
KEY, CERTIFICATE, AUTHORITY = "key.pem", "certificate.pem", "authority.pem"
"""Files of an identity in its folder, and the folder of the services' certificates."""
LONGEST_NAME = 64
"""Of a certificate (RFC 5280, ub-common-name)."""
_PERSONAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


class IdentityError(DeltaqError):
    """An identity is missing, of another cell, out of date, not kept secret, or has an unexpected name."""


class IdentityKind(StrEnum):
    """The kind of an identity's owner."""

    SERVICE = "service"
    OPERATOR = "operator"
    CONTROLLER = "controller"


def name_of(kind: IdentityKind, name: str) -> str:
    """The name of an identity, from the name on the command line.

    Raises:
        IdentityError: if it cannot be the name of a folder, or is too long.
    """
    full = name if kind is IdentityKind.SERVICE else f"{kind}-{name}"
    if not _PERSONAL.fullmatch(name) or len(full) > LONGEST_NAME:
        most = LONGEST_NAME - len(full) + len(name)
        raise IdentityError(
            f"{name!r:.80} cannot be the name of an identity; 1 to {most} letters, digits, `-` and `_` can, the first "
            "a letter or a digit"
        )
    return full


def kind_of(full: str) -> IdentityKind:
    """The kind of the identity with this name."""
    for kind in (IdentityKind.OPERATOR, IdentityKind.CONTROLLER):
        if full.startswith(f"{kind}-"):
            return kind
    return IdentityKind.SERVICE


def person_named(full: str) -> str:
    """The name, if it is an operator's or a controller's; otherwise an empty text."""
    return "" if kind_of(full) is IdentityKind.SERVICE else full
