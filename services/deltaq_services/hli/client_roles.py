"""Roles of clients by their tokens.

Pure. Without an operator's token every client is an operator: for one machine whose users trust one another.
"""

import hmac
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass

from deltaq_cell.description import CellDescription
from deltaq_cell.open_realm import ALLOWS_ANYBODY, NEEDS_TOKENS, off_loopback
from deltaq_protocol.certified.names import AUTHORITY_FILE, IDENTITY, IdentityKind, kind_of
from deltaq_protocol.given_token import MAKE_ONE, OPERATOR_TOKEN, GivenTokenError, given_token
from deltaq_protocol.topic import ClientRole

_ROLES = {
    IdentityKind.SERVICE: ClientRole.OBSERVER,
    IdentityKind.CONTROLLER: ClientRole.CONTROLLER,
    IdentityKind.OPERATOR: ClientRole.OPERATOR,
}


@dataclass(frozen=True)
class ClientRoles:
    """The tokens of a cell.

    Attributes:
        operator_token: None: every client is an operator.
        controller_token: None: every other client is a controller.
    """

    operator_token: str | None = None
    controller_token: str | None = None

    def of(self, token: str | None, identity: str = "") -> ClientRole:
        """The role of a client that gives this token, compared in constant time, or has proven this identity."""
        return max(self._by_token(token), _ROLES[kind_of(identity)])

    def _by_token(self, token: str | None) -> ClientRole:
        is_operator, is_controller = _is(self.operator_token, token), _is(self.controller_token, token)
        if self.operator_token is None or is_operator:
            return ClientRole.OPERATOR
        return (
            ClientRole.CONTROLLER if self.controller_token is None or is_controller else ClientRole.OBSERVER
        )

    def is_wrong(self, token: str) -> bool:
        """Whether a token was given that is neither of the two."""
        known = [wanted for wanted in (self.operator_token, self.controller_token) if wanted is not None]
        return bool(known) and not any(_is(wanted, token) for wanted in known)

    @property
    def tokens(self) -> tuple[str, ...]:
        """The configured tokens."""
        return tuple(token for token in (self.operator_token, self.controller_token) if token is not None)


def _is(wanted: str | None, token: str | None) -> bool:
    # JSON can smuggle in half a surrogate pair, which is no text
    given = (token or "").encode(errors="replace")
    return wanted is not None and hmac.compare_digest(given, wanted.encode())


# The tokens of clients, from files or from the environment, and a cell's rules for them.

CONTROLLER_TOKEN = "DELTAQ_CONTROLLER_TOKEN"
"""Environment variable: where set, a lease needs this token, or the operator's."""
LEAST_CHARACTERS = 16
"""Least length of tokens for clients on other machines: a random one of this length cannot be guessed."""


def client_roles(cell: CellDescription, environment: Mapping[str, str] = os.environ) -> ClientRoles:
    """The roles of a cell's clients.

    A token is in the variable, or in the file that the variable with `_FILE` behind its name gives.

    Raises:
        GivenTokenError: if the cell needs tokens that are not there, or they are no secrets.
    """
    operator = given_token(OPERATOR_TOKEN, environment)
    controller = given_token(CONTROLLER_TOKEN, environment)
    if controller is not None and operator is None:
        raise GivenTokenError(
            f"{CONTROLLER_TOKEN} is set and {OPERATOR_TOKEN} is not: then everybody is an operator; set both"
        )
    if controller is not None and controller == operator:
        raise GivenTokenError(f"{CONTROLLER_TOKEN} and {OPERATOR_TOKEN} are the same; draw two tokens")
    if cell.clients_need_tokens:
        if environment.get(IDENTITY) or environment.get(AUTHORITY_FILE):
            # identities prove the same; with a random token all clients without an identity are observers
            operator, controller = (token or secrets.token_hex() for token in (operator, controller))
        for name, token in ((OPERATOR_TOKEN, operator), (CONTROLLER_TOKEN, controller)):
            if token is None:
                raise GivenTokenError(
                    f"cell {cell.cell} has `{NEEDS_TOKENS}: true`, and neither {name}_FILE nor {name} is set; "
                    f"{MAKE_ONE}, and {name}_FILE names it; or give the HLI an identity ({IDENTITY})"
                )
            if len(token) < LEAST_CHARACTERS:
                raise GivenTokenError(
                    f"{name}: {len(token)} characters, at least {LEAST_CHARACTERS} are needed; {MAKE_ONE}"
                )
    elif (exposed := off_loopback(cell)) is not None and not cell.anyone_who_connects_may_move_the_robots:
        field, value = exposed
        raise GivenTokenError(
            f"{field} ({value}) of cell {cell.cell} lets other machines move its robots; set `{NEEDS_TOKENS}: true` "
            f"and give the tokens, listen on 127.0.0.1, or set `{ALLOWS_ANYBODY}: true`"
        )
    return ClientRoles(operator, controller)
