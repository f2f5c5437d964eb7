"""An HLI over TLS: who has no identity of the cell does not connect, and who reads along reads nothing."""

import contextlib
import socket
import threading

import pytest
from identities import make
from live_stack import live_stack

from deltaq_deploy.launch.cell_connection import connect
from deltaq_protocol import blocking
from deltaq_protocol.certified.encryption import client_tls
from deltaq_protocol.certified.names import CLIENT_IDENTITY, IDENTITY, IdentityError
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Phase
from deltaq_protocol.session import open_session

# tests/security/test_identified_clients.py holds by day who is served and what each role may do
pytestmark = [pytest.mark.live, pytest.mark.nightly]

STEPS = 20


class Tap:
    """A wire to an endpoint that somebody reads along."""

    def __init__(self, to):
        self._to, self.read = to, bytearray()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self):
        self._listening.close()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                far = socket.create_connection(self._to)
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=pair, daemon=True).start()

    def _carry(self, here, there):
        with contextlib.suppress(OSError):
            while data := here.recv(65536):
                self.read += data
                there.sendall(data)
            there.shutdown(socket.SHUT_WR)


def stack_over(transport, folder):
    base = folder / "base.yaml"
    base.write_text(
        f"extends: lab\nhli: {transport}/127.0.0.1:7447\nclients_need_tokens: true\n", encoding="utf-8"
    )
    return live_stack(folder, base=base)


def driven_through(tap, transport):
    """What is read along while a controller takes a robot and moves it."""
    with (
        blocking.connect(f"{transport}/127.0.0.1:{tap.port}", client="tower") as cell,
        cell.lease("gr") as robot,
    ):
        for count, _ in enumerate(robot.states()):
            robot.send([1e-5, *[0.0] * 8])
            if count == STEPS:
                break
    return bytes(tap.read)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    folder = make(tmp_path / "identities", people=("operator-desk", "controller-tower"))
    monkeypatch.setenv(IDENTITY, str(folder))
    return folder


def test_only_clients_with_an_identity_connect_and_traffic_is_encrypted(tmp_path, folder, monkeypatch):
    others = make(tmp_path / "others", people=("operator-desk",))
    with stack_over("tls", tmp_path) as stack:
        address = stack.cell.hli
        plain = address.replace("tls/", "tcp/")
        monkeypatch.delenv(IDENTITY)
        # strangers, before anybody who may
        with pytest.raises(IdentityError, match="is encrypted, and DELTAQ_CLIENT_IDENTITY names no identity"):
            blocking.connect(address).open()
        with pytest.raises(ServiceUnreachableError):
            blocking.connect(address, identity=others / "operator-desk").open()
        with pytest.raises(ServiceUnreachableError):
            open_session(connect=[plain], must_connect=True)
        monkeypatch.setenv(CLIENT_IDENTITY, str(tmp_path))
        with pytest.raises(IdentityError, match=r"authority.pem is missing there"):
            blocking.connect(address).open()

        monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "controller-tower"))
        tap = Tap(Endpoint.parse(address).address)
        read = driven_through(tap, "tls")
        tap.close()
        assert len(read) > 10_000
        assert b"deltaq" not in read
        assert b"q_cmd" not in read
        with connect(stack.cell, "test") as running:
            assert running.status().robots["gr"].counters["admissions"] > 0
            with pytest.raises(RefusedError, match="not_permitted"):
                running.reset("gr")
        monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "operator-desk"))
        with connect(stack.cell, "desk") as running:
            running.stop()
        # what serves on this machine needs no identity of a person
        monkeypatch.delenv(CLIENT_IDENTITY)
        monkeypatch.setenv(IDENTITY, str(folder))
        assert client_tls(address) is not None
        with connect(stack.cell, "test") as running:
            while running.status().robots["gr"].phase is not Phase.HELD:
                stack.wait_cycles(1)


def test_without_encryption_an_eavesdropper_reads_all_traffic(tmp_path, folder, monkeypatch):
    """The control: the same tap at the same place."""
    with stack_over("tcp", tmp_path) as stack:
        monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "controller-tower"))
        tap = Tap(Endpoint.parse(stack.cell.hli).address)
        read = driven_through(tap, "tcp")
        tap.close()
        assert b"q_cmd" in read
