"""A token of a service or client: in an environment variable, or in a file that such a variable names."""

import os
from collections.abc import Mapping
from pathlib import Path

from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.secret_file import contents, faults_of_secret

OPERATOR_TOKEN = "DELTAQ_OPERATOR_TOKEN"
"""Environment variable: the operator's token, for the HLI, the console, and commands of an operator."""
CLIENT_TOKEN = "DELTAQ_CLIENT_TOKEN"
"""Environment variable: the token of a client that is given none by its program."""
MAKE_ONE = "`openssl rand -hex 16 > FILE; chmod 600 FILE` makes one"


class GivenTokenError(DeltaqError):
    """A token that is missing, too short, or not a secret."""


def given_token(name: str, environment: Mapping[str, str] = os.environ) -> str | None:
    """The token in the file that the variable `name` with `_FILE` behind it names, or in the variable; None if in none.

    Raises:
        GivenTokenError: if the file cannot be read, is not this user's secret, or holds no text.
    """
    file = environment.get(f"{name}_FILE")
    if not file:
        return environment.get(name) or None
    try:
        about, text = contents(Path(file))
    except OSError as error:
        raise GivenTokenError(f"{name}_FILE: {file} cannot be read: {error.strerror}") from error
    if faults := faults_of_secret(about, Path(file), "openssl rand -hex 16"):
        raise GivenTokenError(f"{name}_FILE: {file} {faults[0]}")
    try:
        token = text.decode().strip()
    except UnicodeDecodeError:
        token = ""  # reported like an empty one, and never shown
    if not token:
        raise GivenTokenError(f"{name}_FILE: {file} holds no text; {MAKE_ONE}")
    return token
