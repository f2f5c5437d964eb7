"""The tokens that clients show, from files or from the environment, and what a cell needs of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from deltaq_cell.description import CellDescription
from deltaq_cell.open_realm import ALLOWS_ANYBODY, NEEDS_TOKENS, off_loopback
from deltaq_protocol.errors import DeltaqError
from deltaq_services.guarded_key import faults_of_secret
from deltaq_services.hli.client_roles import ClientRoles

OPERATOR_TOKEN = "DELTAQ_OPERATOR_TOKEN"
"""Environment variable: where set, `take`, `reset` and `contact` need this token."""
CONTROLLER_TOKEN = "DELTAQ_CONTROLLER_TOKEN"
"""Environment variable: where set, a lease needs this token, or the operator's."""
LEAST_CHARACTERS = 16
"""Of tokens that clients on other machines show: nobody guesses so long a one, where it was drawn by chance."""
_MOST_BYTES = 4096
_MAKE_ONE = "`openssl rand -hex 16 > FILE; chmod 600 FILE` makes one"


class ClientTokenError(DeltaqError):
    """A token that is missing, too short, or not a secret."""


def client_roles(cell: CellDescription, environment: Mapping[str, str] = os.environ) -> ClientRoles:
    """The roles of a cell's clients.

    A token is in the variable, or in the file that the variable with `_FILE` behind its name gives.

    Raises:
        ClientTokenError: if the cell needs tokens that are not there, or they are no secrets.
    """
    operator = _token(OPERATOR_TOKEN, environment)
    controller = _token(CONTROLLER_TOKEN, environment)
    if controller is not None and operator is None:
        raise ClientTokenError(
            f"{CONTROLLER_TOKEN} is set and {OPERATOR_TOKEN} is not: then everybody is an operator; set both"
        )
    if controller is not None and controller == operator:
        raise ClientTokenError(f"{CONTROLLER_TOKEN} and {OPERATOR_TOKEN} are the same; draw two tokens")
    if cell.clients_need_tokens:
        for name, token in ((OPERATOR_TOKEN, operator), (CONTROLLER_TOKEN, controller)):
            if token is None:
                raise ClientTokenError(
                    f"cell {cell.cell} has `{NEEDS_TOKENS}: true`, and neither {name}_FILE nor {name} is set; "
                    f"{_MAKE_ONE}, and {name}_FILE names it"
                )
            if len(token) < LEAST_CHARACTERS:
                raise ClientTokenError(
                    f"{name}: {len(token)} characters, at least {LEAST_CHARACTERS} are needed; {_MAKE_ONE}"
                )
    elif (exposed := off_loopback(cell)) is not None and not cell.anyone_who_connects_may_move_the_robots:
        field, value = exposed
        raise ClientTokenError(
            f"{field} ({value}) of cell {cell.cell} lets other machines move its robots; set `{NEEDS_TOKENS}: true` "
            f"and give the tokens, listen on 127.0.0.1, or set `{ALLOWS_ANYBODY}: true`"
        )
    return ClientRoles(operator, controller)


def _token(name: str, environment: Mapping[str, str]) -> str | None:
    file = environment.get(f"{name}_FILE")
    if not file:
        return environment.get(name) or None
    try:
        with Path(file).open("rb") as opened:
            about, text = os.fstat(opened.fileno()), opened.read(_MOST_BYTES)
    except OSError as error:
        raise ClientTokenError(f"{name}_FILE: {file} cannot be read: {error.strerror}") from error
    if faults := faults_of_secret(about, Path(file)):
        raise ClientTokenError(f"{name}_FILE: {file} {faults[0]}")
    try:
        token = text.decode().strip()
    except UnicodeDecodeError:
        token = ""  # reported like an empty one, and never shown
    if not token:
        raise ClientTokenError(f"{name}_FILE: {file} holds no text; {_MAKE_ONE}")
    return token
