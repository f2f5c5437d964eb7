"""The tokens that clients show, from files or from the environment, and what a cell needs of them."""

from __future__ import annotations

import os
import secrets
from collections.abc import Mapping

from deltaq_cell.description import CellDescription
from deltaq_cell.open_realm import ALLOWS_ANYBODY, NEEDS_TOKENS, off_loopback
from deltaq_protocol.certified.names import AUTHORITY_FILE, IDENTITY
from deltaq_protocol.given_token import MAKE_ONE, OPERATOR_TOKEN, GivenTokenError, given_token
from deltaq_services.hli.client_roles import ClientRoles

CONTROLLER_TOKEN = "DELTAQ_CONTROLLER_TOKEN"
"""Environment variable: where set, a lease needs this token, or the operator's."""
LEAST_CHARACTERS = 16
"""Of tokens that clients on other machines show: nobody guesses so long a one, where it was drawn by chance."""


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
            # identities prove the same; a token that nobody has leaves the others observers
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
