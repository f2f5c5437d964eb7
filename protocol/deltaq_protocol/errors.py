"""The one exception base of deltaq.

A message says what was wrong, what was given, what is allowed and what to do next.
"""

from typing import Literal

Severity = Literal["error", "warning"]
"""Severity of a finding in a file: a file with an error is not used; a warning is only shown."""


class DeltaqError(Exception):
    """Base of every error that deltaq raises on purpose."""


class ProtocolError(DeltaqError):
    """Bytes from a link that are no valid message."""


class ServiceUnreachableError(DeltaqError):
    """No answer from a service within the time allowed."""


class RefusedError(DeltaqError):
    """A valid request was refused.

    Attributes:
        code: reason code, one of `deltaq_protocol.reasons.ReasonCode`.
        hint: what the caller can do about it.
    """

    def __init__(self, code: str, message: str, hint: str = "") -> None:
        super().__init__(f"{code}: {message}" + (f" ({hint})" if hint else ""))
        self.code = code
        self.hint = hint
