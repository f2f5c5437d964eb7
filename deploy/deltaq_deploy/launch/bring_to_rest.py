"""Stops of a running cell: bring its robots to rest, also over the JSON lines when no zenoh session can be had."""

import json
import os
import socket
import ssl
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.cell_connection import Where, connect
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Done, Error, Phase, RobotStatus
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.line_encryption import CERTIFICATE_FILE, LineEncryptionError

TIMEOUT_S = 5.0
POLL_S = 0.05
STILL = 1e-5
"""Change of a joint between two states that counts as standing still [rad or m]."""


def bring_to_rest(cell: CellDescription, client: str) -> None:
    """Stop every robot of a cell through its HLI, and wait until each is at rest.

    Args:
        cell: the cell's description.
        client: name of the client that asks.

    Raises:
        ServiceUnreachableError: if the HLI does not answer, or a robot is not at rest within `TIMEOUT_S`.
    """
    deadline = time.monotonic() + TIMEOUT_S
    # without comparing descriptions of the cell: any client may stop
    with connect(Where(cell.hli, cell.cell), client) as running:
        with suppress(RefusedError):  # not confirmed: the stop was sent, and its effect is checked below
            running.stop()
        before: dict[str, RobotStatus] = {}
        while True:
            robots = running.status().robots
            moving = [name for name, robot in robots.items() if not rests(before.get(name), robot)]
            if not moving:
                return
            if time.monotonic() > deadline:
                raise ServiceUnreachableError(f"{', '.join(moving)} not at rest {TIMEOUT_S:g} s after a stop")
            before = robots
            time.sleep(POLL_S)


def rests(before: RobotStatus | None, now: RobotStatus) -> bool:
    """Whether a robot is held and was measured at one place twice; a held robot may still be braking."""
    if now.phase is Phase.OFFLINE or now.reason is ReasonCode.KRC_LOST:
        return True  # it is silent: there is nothing to wait for
    if now.phase is not Phase.HELD or before is None or before.cycle == now.cycle:
        return False
    return all(abs(q - q_before) < STILL for q, q_before in zip(now.q, before.q, strict=True))


_DEADLINE_S = 2.0
_STOP = b'{"type":"stop"}\n'


def stop_over_a_line(cell: CellDescription, environment: Mapping[str, str] = os.environ) -> Done:
    """Bring every robot of a running cell to rest.

    Args:
        cell: the cell.
        environment: may name the certificate of the HLI, see `line_encryption`. Then only an answer with that
            certificate counts. The stop is also sent in the clear: an HLI obeys it also where lines are encrypted,
            before any TLS handshake.

    Raises:
        RefusedError: `unreachable`, if not all have shown in time that they are held; the stop was sent all the
            same.
        LineEncryptionError: the certificate cannot be read, or the server has another one.
        ServiceUnreachableError: no server listens there, or no answer came in time.
    """
    certificate = environment.get(CERTIFICATE_FILE)
    if not certificate:
        return _stopped(cell)
    with _told_ahead(cell):
        try:
            return _stopped(cell, certificate)
        except ServiceUnreachableError as error:
            text = "a stop was also sent in the clear, which an HLI obeys, but no server has proved to be the HLI"
            raise ServiceUnreachableError(f"{error}; {text}") from error


@contextmanager
def _told_ahead(cell: CellDescription) -> Iterator[None]:
    """Within the block a stop is sent in the clear; its answer is not authenticated."""
    with ExitStack() as opened:
        with suppress(OSError):
            line = opened.enter_context(_connected(cell))
            line.sendall(_STOP)
        yield


def _stopped(cell: CellDescription, certificate: str | None = None) -> Done:
    """Stop in the clear, or over an encrypted line to the server with that certificate."""
    place = f"{cell.tcp_address}:{cell.tcp_port}"
    try:
        with _connected(cell) as connection:
            if certificate is None:
                return _asked(connection, place)
            with _encryption(certificate).wrap_socket(connection) as line:
                return _asked(line, place)
    except ssl.SSLCertVerificationError as error:
        text = f"the server at {place} got the stop, but does not have the certificate {certificate}"
        raise LineEncryptionError(text) from error
    except (OSError, ValueError) as error:  # a TLS server may answer with TLS bytes, which is no answer
        raise ServiceUnreachableError(f"no stop over {place}: {error}") from error


def _connected(cell: CellDescription) -> socket.socket:
    return socket.create_connection((cell.tcp_address, cell.tcp_port), _DEADLINE_S)


def _encryption(certificate: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False  # the certificate itself is known
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # by any issuer
    try:
        context.load_verify_locations(certificate)
    except OSError as error:
        text = f"no certificate in {certificate}: {error}; {CERTIFICATE_FILE} names it"
        raise LineEncryptionError(text) from error
    return context


def _asked(line: socket.socket, place: str) -> Done:
    line.sendall(_STOP)
    with line.makefile("rb") as answers:
        for answer in map(json.loads, answers):
            if answer["type"] == "done":
                return Done.model_validate(answer)
            if answer["type"] == "error" and answer["request"] == "stop":
                error = Error.model_validate(answer)
                raise RefusedError(ReasonCode(error.code), error.message, error.hint)
    raise ServiceUnreachableError(f"no answer to a stop from {place}")
