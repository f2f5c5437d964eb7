"""TLS for the JSON lines, if the HLI has a certificate; without one they are unencrypted.

A client may show a certificate of its own: one of the cell's authority proves an operator's or a controller's name.
"""

import os
import ssl
from collections.abc import Mapping

from deltaq_cell.description import CellDescription
from deltaq_cell.open_realm import is_loopback
from deltaq_protocol.errors import DeltaqError

CERTIFICATE_FILE, KEY_FILE = "DELTAQ_LINES_CERTIFICATE_FILE", "DELTAQ_LINES_KEY_FILE"
"""Environment variables: paths of the certificate and its private key, PEM."""


class LineEncryptionError(DeltaqError):
    """A certificate or key is missing or invalid."""


def is_overheard(address: str, is_encrypted: bool) -> bool:
    """Whether others on a network can read a client's lines.

    Args:
        address: of the other end; a host by number.
        is_encrypted: whether TLS was agreed on.
    """
    return not is_encrypted and not is_loopback(address)


def line_encryption(
    cell: CellDescription, environment: Mapping[str, str] = os.environ, authority: str = ""
) -> ssl.SSLContext | None:
    """What encrypts the lines; None: nothing does.

    Args:
        cell: the cell.
        environment: environment variables with the file names.
        authority: certificate of the cell's authority (PEM), which signs clients' certificates; empty: none is valid.

    Raises:
        LineEncryptionError: if the certificate or its key cannot be used, or tokens would cross a network unencrypted.
    """
    certificate, key = environment.get(CERTIFICATE_FILE), environment.get(KEY_FILE)
    if not certificate and not key:
        if cell.clients_need_tokens and not is_loopback(cell.tcp_address):
            raise LineEncryptionError(
                f"tcp_address ({cell.tcp_address}) of cell {cell.cell} is not this machine's loopback, and clients "
                f"would send their tokens in the clear; set {CERTIFICATE_FILE} and {KEY_FILE}, or listen on 127.0.0.1"
            )
        return None
    if not certificate or not key:
        raise LineEncryptionError(
            f"{CERTIFICATE_FILE} and {KEY_FILE} go together, and one of them is not set"
        )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        why = error.reason if isinstance(error, ssl.SSLError) else error.strerror
        raise LineEncryptionError(f"{certificate} with {key} cannot be used: {why}") from error
    if authority:
        # a client without a certificate proves a role by a token, or has none
        context.verify_mode = ssl.CERT_OPTIONAL
        context.load_verify_locations(cadata=authority)
    return context
