"""Errors of an RSI configuration or telegram."""

from __future__ import annotations

from deltaq_protocol.errors import DeltaqError, ProtocolError


class EthernetConfigError(DeltaqError):
    """A `*_ethernet.xml` that cannot be used; the message names file, element, value and what is allowed."""


class TelegramError(ProtocolError):
    """A datagram that is no telegram of this configuration, or a value that no telegram can carry."""
