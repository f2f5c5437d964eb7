"""ClientRoles of clients: what a token makes of whoever has it. Plain decisions.

Where no operator's token is set, everybody is an operator: that is for one machine, whose users trust one another.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass

from deltaq_protocol.certified.names import IdentityKind, kind_of
from deltaq_protocol.client_rights import ClientRole

_ROLES = {
    IdentityKind.SERVICE: ClientRole.OBSERVER,
    IdentityKind.CONTROLLER: ClientRole.CONTROLLER,
    IdentityKind.OPERATOR: ClientRole.OPERATOR,
}


@dataclass(frozen=True)
class ClientRoles:
    """The tokens of a cell.

    Attributes:
        operator_token: None: everybody is an operator.
        controller_token: None: everybody who is not the operator is a controller.
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
        """The tokens that are set."""
        return tuple(token for token in (self.operator_token, self.controller_token) if token is not None)


def _is(wanted: str | None, token: str | None) -> bool:
    # JSON can smuggle in half a surrogate pair, which is no text
    given = (token or "").encode(errors="replace")
    return wanted is not None and hmac.compare_digest(given, wanted.encode())
