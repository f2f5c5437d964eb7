"""A stop over the JSON lines, where places are kept for it: for when no zenoh session can be had."""

from __future__ import annotations

import json
import os
import socket
import ssl
from collections.abc import Mapping

from deltaq_cell.description import CellDescription
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Done, Error
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.line_encryption import CERTIFICATE_FILE, LineEncryptionError

_DEADLINE_S = 2.0


class _LineEndedError(ServiceUnreachableError):
    """The other end ended the connection without an answer."""


def stop_over_a_line(cell: CellDescription, environment: Mapping[str, str] = os.environ) -> Done:
    """Bring every robot of a running cell to rest.

    Args:
        cell: the cell.
        environment: may name the certificate of the HLI, see `line_encryption`, which then has to have it. Otherwise a
            stop is sent to whoever listens there, encrypted where it is not taken in the clear.

    Raises:
        RefusedError: `unreachable`, if not all have shown in time that they are held; they were told all the same.
        LineEncryptionError: the certificate cannot be read, or is not that of who listens there.
        ServiceUnreachableError: nobody listens there, or no answer came in time.
    """
    certificate = environment.get(CERTIFICATE_FILE)
    if certificate:
        return _stopped(cell, certificate)
    try:
        return _stopped(cell)
    except _LineEndedError:
        return _stopped(cell, "")


def _stopped(cell: CellDescription, certificate: str | None = None) -> Done:
    """Stop in the clear, or encrypted: by the HLI with that certificate, or by any if it is empty."""
    place = f"{cell.tcp_address}:{cell.tcp_port}"
    try:
        with socket.create_connection((cell.tcp_address, cell.tcp_port), _DEADLINE_S) as connection:
            if certificate is None:
                return _asked(connection, place)
            with _encryption(certificate).wrap_socket(connection) as line:
                return _asked(line, place)
    except ssl.SSLCertVerificationError as error:
        raise LineEncryptionError(f"who listens on {place} has not the certificate {certificate}") from error
    except (ConnectionResetError, ValueError) as error:
        # who speaks TLS may say so, which is no answer in the clear
        raise _LineEndedError(f"no stop over {place}: {error}") from error
    except OSError as error:
        raise ServiceUnreachableError(f"no stop over {place}: {error}") from error


def _encryption(certificate: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False  # the certificate itself is known, or nothing is
    if certificate:
        try:
            context.load_verify_locations(certificate)
        except OSError as error:
            text = f"no certificate in {certificate}: {error}; {CERTIFICATE_FILE} names it"
            raise LineEncryptionError(text) from error
        context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # whoever signed it
    else:
        context.verify_mode = ssl.CERT_NONE
    return context


def _asked(line: socket.socket, place: str) -> Done:
    line.sendall(b'{"type":"stop"}\n')
    with line.makefile("rb") as answers:
        for answer in map(json.loads, answers):
            if answer["type"] == "done":
                return Done.model_validate(answer)
            if answer["type"] == "error" and answer["request"] == "stop":
                error = Error.model_validate(answer)
                raise RefusedError(ReasonCode(error.code), error.message, error.hint)
    raise _LineEndedError(f"no answer to a stop from {place}")
