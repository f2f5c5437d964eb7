"""The settings of a console, and its access control: the role of a client by its token.

Pure: the shell passes the time.
"""

import hmac
from collections import Counter
from dataclasses import dataclass, field
from enum import Enum, auto
from ipaddress import ip_address
from pathlib import Path

from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.given_token import MAKE_ONE
from deltaq_services.rate_limit import Tries

LOOPBACK_HOSTS = ("localhost", "127.0.0.1", "[::1]")
"""Names by which a browser on this machine may call it. Any other is a web site that pretends to live here."""


CONSOLE_TOKEN = "DELTAQ_CONSOLE_TOKEN"
"""Environment variable: the token of the console's operators."""
LEAST_CHARACTERS = 16
"""Least length of the console's token: a random one of this length cannot be guessed."""


class NoTokenError(DeltaqError):
    """The console is reachable by others, and no token distinguishes its operators."""


class NoFolderError(DeltaqError):
    """The given folder for recordings does not exist."""


@dataclass(frozen=True)
class Settings:
    """The settings of a console.

    Attributes:
        cell: name of the cell.
        emulated: no robot of it is real.
        address: it is bound to.
        port: it is bound to.
        token: a client that shows it is an operator; empty: every client on this machine is one.
        operator_token: the HLI's, which resets and drivers need if the HLI was given one.
        has_role: the environment has a token or an identity that the console's drivers show to the HLI.
        recordings: folder in which recordings are written and opened; None for none.

    Raises:
        NoTokenError: there is no token, or one that can be guessed, and the console is reached from other machines or
            commands in the name of a role that others of this machine do not have.
        NoFolderError: there is no such folder for recordings.
    """

    cell: str
    emulated: bool
    address: str
    port: int
    token: str = field(default="", repr=False)
    operator_token: str | None = field(default=None, repr=False)
    has_role: bool = False
    recordings: Path | None = None

    def __post_init__(self) -> None:
        if not self.is_loopback and not self.token:
            raise NoTokenError(
                f"the console would be reached from other machines at {self.address}: set {CONSOLE_TOKEN} or "
                f"{CONSOLE_TOKEN}_FILE, which its operators then have to know, or bind it to 127.0.0.1"
            )
        if (self.operator_token or self.has_role) and not self.token:
            raise NoTokenError(
                "the console has a token or an identity of the cell's, and would give its rights to every user "
                f"of this machine: give it a token of its own ({CONSOLE_TOKEN}_FILE; {MAKE_ONE}), start it with "
                "`deltaq up`, which makes one, or start it without the cell's token and identity"
            )
        if self.token and len(self.token) < LEAST_CHARACTERS:
            raise NoTokenError(
                f"{CONSOLE_TOKEN}: {len(self.token)} characters, at least {LEAST_CHARACTERS} are needed; {MAKE_ONE}"
            )
        if self.recordings is not None and not self.recordings.is_dir():
            raise NoFolderError(f"--recordings {self.recordings}: there is no such folder; make it first")

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        try:
            return ip_address(self.address).is_loopback
        except ValueError:
            return self.address == "localhost"

    @property
    def url(self) -> str:
        """The console's address for a browser on this machine."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        return f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{self.port}"

    @property
    def token_needed(self) -> bool:
        """Whether a client without the token may only look, and stop."""
        return bool(self.token)

    def is_operator(self, token: str) -> bool:
        """Whether this token allows commands."""
        return not self.token or hmac.compare_digest(token.encode(), self.token.encode())


class Entrance(Enum):
    """The role that a token gives."""

    OPERATOR = auto()
    OBSERVER = auto()
    WRONG = auto()
    """It was compared, and is not the console's."""
    NOT_COMPARED = auto()
    """Too many wrong ones came from there: no more are looked at for a moment."""


class Door:
    """Looks at tokens, and not at many wrong ones of an address.

    Args:
        settings: have the console's token.
        counters: count tokens that were wrong, and those that were not compared.
    """

    def __init__(self, settings: Settings, counters: Counter[str]) -> None:
        self._settings = settings
        self._counters = counters
        self._tries = Tries()

    def look(self, token: str, address: str, time_s: float) -> Entrance:
        """The role that a token from an address gives; an empty token is none."""
        if not token:
            return Entrance.OBSERVER if self._settings.token_needed else Entrance.OPERATOR
        if not self._tries.may_try(address, time_s):
            self._counters["tokens_not_compared"] += 1
            return Entrance.NOT_COMPARED
        if self._settings.is_operator(token):
            return Entrance.OPERATOR
        self._tries.failed(address, time_s)
        self._counters["tokens_wrong"] += 1
        return Entrance.WRONG
