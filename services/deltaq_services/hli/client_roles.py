"""ClientRoles of clients: what a token makes of whoever has it. Plain decisions; the shell passes the time in.

Where no operator's token is set, everybody is an operator: that is for one machine, whose users trust one another.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass

from deltaq_protocol.certified.names import IdentityKind, kind_of
from deltaq_protocol.client_rights import ClientRole
from deltaq_services.rate_limit import RateLimit

MOST_TRIES_S = 3.0
"""Wrong tokens a second of one peer; what comes beyond is not compared."""
_MOST_PEERS = 256


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
        """The role of who gives this token, compared in constant time, or has proven this identity."""
        return max(self._by_token(token), _ROLES[kind_of(identity)])

    def _by_token(self, token: str | None) -> ClientRole:
        is_operator, is_controller = _is(self.operator_token, token), _is(self.controller_token, token)
        if self.operator_token is None or is_operator:
            return ClientRole.OPERATOR
        return (
            ClientRole.CONTROLLER if self.controller_token is None or is_controller else ClientRole.OBSERVER
        )

    def is_wrong(self, token: str) -> bool:
        """Whether a token was given and is none of these."""
        known = [wanted for wanted in (self.operator_token, self.controller_token) if wanted is not None]
        return bool(known) and not any(_is(wanted, token) for wanted in known)

    @property
    def tokens(self) -> tuple[str, ...]:
        """Those that are set."""
        return tuple(token for token in (self.operator_token, self.controller_token) if token is not None)


class Tries:
    """Wrong tokens, by the address that they came from: only so many of each are compared in a second."""

    def __init__(self) -> None:
        self._rates: dict[str, RateLimit] = {}

    def may_try(self, address: str, time_s: float) -> bool:
        """Whether a token from there is compared at all."""
        return address not in self._rates or self._rates[address].has_left(time_s)

    def failed(self, address: str, time_s: float) -> None:
        """A wrong token came from there."""
        while len(self._rates) >= _MOST_PEERS and address not in self._rates:
            del self._rates[next(iter(self._rates))]
        self._rates.setdefault(address, RateLimit(MOST_TRIES_S)).take(time_s)


def _is(wanted: str | None, token: str | None) -> bool:
    # JSON can smuggle in half a surrogate pair, which is no text
    given = (token or "").encode(errors="replace")
    return wanted is not None and hmac.compare_digest(given, wanted.encode())
