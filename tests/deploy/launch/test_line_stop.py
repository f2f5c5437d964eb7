"""A stop over the lines, when no session can be had."""

import contextlib
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from certificate import certificate
from served import Server
from small_cell import small_cell

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.bring_to_rest import stop_over_a_line
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_services.hli.line_encryption import CERTIFICATE_FILE, KEY_FILE, LineEncryptionError


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return certificate(tmp_path_factory.mktemp("certificate"))


def test_a_missing_listener_is_reported() -> None:
    with pytest.raises(ServiceUnreachableError):
        stop_over_a_line(small_cell())


def test_a_stop_is_confirmed_or_reported_unconfirmed() -> None:
    with Server() as server:
        assert stop_over_a_line(server.description).what == "stop"
        assert server.command().kind == "stop"
        server.peer.obeys = False
        with pytest.raises(RefusedError, match="did not answer"):
            stop_over_a_line(server.description)


@pytest.mark.parametrize("is_known", [True, False])
def test_encrypted_lines_carry_a_stop_with_and_without_the_certificate_of_the_server(
    files: dict[str, str], is_known: bool
) -> None:
    with Server(encrypted=files) as server:
        assert stop_over_a_line(server.description, files if is_known else {}).what == "stop"
        assert server.command().kind == "stop"


def test_a_given_certificate_is_trusted_without_its_issuer(tmp_path: Path) -> None:
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2")
    key, signed = tmp_path / "lines.key", tmp_path / "lines.pem"
    ours, theirs = tmp_path / "authority.key", tmp_path / "authority.pem"
    by_them = ("-CA", theirs, "-CAkey", ours)
    for name, private, public, by in (("them", ours, theirs, ()), ("deltaq", key, signed, by_them)):
        about = ("-subj", f"/CN={name}", "-keyout", private, "-out", public)
        command = ["openssl", "req", "-x509", *curve, *about, *by]
        subprocess.run(command, check=True, capture_output=True)
    files = {CERTIFICATE_FILE: str(signed), KEY_FILE: str(key)}
    with Server(encrypted=files) as server:
        assert stop_over_a_line(server.description, files).what == "stop"


def test_a_server_with_another_certificate_is_not_trusted_but_gets_the_stop(
    files: dict[str, str], tmp_path: Path
) -> None:
    with Server(encrypted=certificate(tmp_path)) as server:
        with pytest.raises(
            LineEncryptionError, match=r"got the stop, but does not have the certificate .*\.pem"
        ):
            stop_over_a_line(server.description, files)
        assert server.command().kind == "stop"
        (tmp_path / "empty.pem").touch()
        for name in ("none.pem", "empty.pem"):
            with pytest.raises(
                LineEncryptionError, match=f"no certificate in .*{name}: .*; {CERTIFICATE_FILE}"
            ):
                stop_over_a_line(server.description, {CERTIFICATE_FILE: str(tmp_path / name)})


@contextlib.contextmanager
def deaf(says: bytes, times: int) -> Iterator[CellDescription]:
    """One who says this to so many that have said something, and ends."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def end() -> None:
            for _ in range(times):
                connection, _ = listener.accept()
                connection.recv(4096)
                connection.sendall(says)
                connection.close()

        ends = threading.Thread(target=end)
        ends.start()
        yield small_cell(tcp_port=listener.getsockname()[1])
        ends.join()


@pytest.mark.parametrize("says", [b"", b"\x15\x03\x03\x00\x02\x02\x46"], ids=["nothing", "an alert of TLS"])
def test_a_connection_that_ends_without_an_answer_is_no_stop(files: dict[str, str], says: bytes) -> None:
    with deaf(says, 1) as cell, pytest.raises(ServiceUnreachableError):
        stop_over_a_line(cell, {})
    with deaf(says, 2) as cell, pytest.raises(ServiceUnreachableError, match="also sent in the clear"):
        stop_over_a_line(cell, files)
