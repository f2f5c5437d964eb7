"""Tokens of launched services: one for the console, and the controllers' in a demonstration.

A console gets a new one if its role would otherwise be open to every user of the machine. It lies in the user's
runtime folder for as long as the launch lasts. Two launches cannot have the same console, since only one gets its port.
"""

import contextlib
import os
import secrets
from collections.abc import Mapping
from pathlib import Path

from deltaq_deploy.launch.program import LaunchError
from deltaq_protocol.given_token import CLIENT_TOKEN, OPERATOR_TOKEN, given_token
from deltaq_protocol.role_prover import environment_has_role
from deltaq_protocol.secret_file import faults_of_secret
from deltaq_services.console.settings import CONSOLE_TOKEN
from deltaq_services.hli.client_roles import CONTROLLER_TOKEN
from deltaq_services.runtime_folder import runtime_folder

_TOKEN_BYTES = 24
_SECRET_BYTES = 32


def console_needs_token(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether a console with this environment has an operator's role, but no token of its own.

    Raises:
        GivenTokenError: a token's file cannot be read, or is no secret.
    """
    if given_token(CONSOLE_TOKEN, environment) is not None:
        return False
    return given_token(OPERATOR_TOKEN, environment) is not None or environment_has_role(environment)


def controllers_token(environment: Mapping[str, str]) -> dict[str, str]:
    """Environment variables with the token of a launch's own controllers; empty if its clients have another."""
    if environment_has_role(environment):
        return {}
    given = {CLIENT_TOKEN: CONTROLLER_TOKEN, f"{CLIENT_TOKEN}_FILE": f"{CONTROLLER_TOKEN}_FILE"}
    return {name: environment[source] for name, source in given.items() if environment.get(source)}


class ConsoleToken:
    """A new token for the console at a port, as long as this is open.

    Attributes:
        file: of mode 0600, that holds it.
        query: the query string of the console's address.

    Raises:
        RuntimeFolderError: if the user has no folder of their own.
        LaunchError: if the file cannot be written.
    """

    def __init__(self, port: int) -> None:
        self.file = runtime_folder() / f"console-{port}.token"
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        self.query = f"/?token={token}"
        _write_anew(self.file, token)

    def page(self, address: str) -> str:
        """The `file:` address of a private page that forwards the user's browser to `address` with the token."""
        page = self.file.with_suffix(".html")
        _write_anew(page, f'<meta http-equiv="refresh" content="0;url={address}{self.query}">')
        return page.as_uri()

    def close(self) -> None:
        """Delete the token file; the console has ended."""
        for file in (self.file, self.file.with_suffix(".html")):
            file.unlink(missing_ok=True)


def write_new_secret(file: Path, *, keep: bool = False) -> None:
    """Write a random secret, in a file that only its owner may read.

    Args:
        file: to write.
        keep: do not replace an existing secret.

    Raises:
        LaunchError: the file cannot be written, it exists and `keep` is false, or the kept one is no secret.
    """
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if not keep:
            raise LaunchError(
                f"{file} exists already; a secret is never overwritten, name another file"
            ) from None
        if faults := faults_of_secret(file.stat(), file, "deltaq keys --secret"):
            raise LaunchError(f"{file} {faults[0]}") from None
        return
    except OSError as error:
        raise LaunchError(f"{file} cannot be written: {error.strerror}") from error
    with os.fdopen(descriptor, "w", encoding="ascii") as opened:
        opened.write(secrets.token_hex(_SECRET_BYTES) + "\n")


def _write_anew(file: Path, text: str) -> None:
    try:
        with contextlib.suppress(FileNotFoundError):
            file.unlink()  # of a launch that was killed
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise LaunchError(f"{file} cannot be written: {error.strerror}") from error
    with os.fdopen(descriptor, "w", encoding="utf-8") as opened:
        opened.write(text + "\n")
