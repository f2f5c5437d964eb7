"""A controller with nothing but a socket and json, against the whole running cell."""

import json
import math
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.live

SCRIPT = Path(__file__).parents[2] / "examples" / "over_a_socket.py"


class Lines:
    """One connection."""

    def __init__(self, sock, file, client):
        self.sock = sock
        self.file = file
        self.send(type="hello", protocol=1, client=client)
        self.welcome = self.receive("welcome")

    def send(self, **message):
        self.send_text(json.dumps(message))

    def send_text(self, text):
        self.sock.sendall(text.encode() + b"\n")

    def receive(self, kind, **fields):
        for line in self.file:
            message = json.loads(line)
            if message["type"] == kind and fields.items() <= message.items():
                return message
        return pytest.fail(f"the connection ended before a {kind}")

    def lease(self, action):
        self.send(type="lease", robot="fr", action=action)
        return self.receive("lease")

    def refused(self, seq, cycle=None, dq=(0, 0, 0, 0, 0, 0), robot="fr"):
        """The reason for which an increment is refused."""
        if cycle is None:
            cycle = self.receive("state", robot="fr")["cycle"]
        self.send(type="increment", robot=robot, seq=seq, cycle=cycle, dq=list(dq))
        verdict = self.receive("verdict", robot=robot, seq=seq)
        assert verdict["outcome"] == "refused"
        return verdict["reasons"][0]


@contextmanager
def connected(stack, client):
    with (
        socket.create_connection(("127.0.0.1", stack.cell.tcp_port), timeout=300) as sock,
        sock.makefile("r", encoding="utf-8", newline="\n") as file,
    ):
        yield Lines(sock, file, client)


@pytest.fixture(scope="module")
def stack(shared_stack):
    return shared_stack.renewed()


def test_the_script_of_thirty_lines_turns_a1_by_ten_degrees(stack):
    before = np.array(stack.emulator()["q"])
    done = subprocess.run(
        [sys.executable, SCRIPT, "127.0.0.1", str(stack.cell.tcp_port)],
        capture_output=True, text=True, timeout=300, check=True,
    )  # fmt: skip
    stack.wait_until_at_rest()
    turned = np.array(stack.emulator()["q"]) - before
    np.testing.assert_allclose(turned, [math.radians(10), 0, 0, 0, 0, 0], atol=math.radians(0.06))
    assert "A1 is at" in done.stdout


def test_a_controller_is_refused_what_is_no_valid_increment_and_goes_on(stack):
    before = np.array(stack.emulator()["q"])
    with connected(stack, "first") as first:
        assert first.lease("acquire")["granted"]
        assert first.refused(1, dq=[None, 0, 0, 0, 0, 0])["code"] == "not_finite"
        assert first.refused(2, dq=[float("nan"), 0, 0, 0, 0, 0])["code"] == "not_finite"
        seven = first.refused(3, dq=[0] * 7)
        assert (seven["code"], seven["value"], seven["bound"]) == ("bad_shape", 7, 6)
        cycle = first.receive("state", robot="fr")["cycle"]
        stale = first.refused(4, cycle=cycle - 60)
        assert stale["code"] == "stale_cycle"
        assert stale["bound"] >= cycle - 60
        assert first.refused(5, robot="gr", dq=[0] * 9)["code"] == "lease_not_held"
        assert first.refused(4)["code"] == "replayed_sequence"
        first.send_text("this is no json")
        assert first.receive("error")["code"] == "malformed"
        state = first.receive("state", robot="fr")
        first.send(type="increment", robot="fr", seq=9, cycle=state["cycle"], dq=[1e-5, 0, 0, 0, 0, 0])
        assert first.receive("verdict", seq=9)["outcome"] == "admitted"
        assert first.lease("release")["granted"]
    assert np.max(np.abs(np.array(stack.emulator()["q"]) - before)) < 1e-3


def test_a_second_controller_is_refused_the_lease_and_gets_it_once_it_is_free(stack):
    with connected(stack, "first") as first, connected(stack, "second") as second:
        assert first.lease("acquire")["granted"]
        taken = second.lease("acquire")
        assert (taken["granted"], taken["holder"], taken["code"]) == (False, "first", "lease_taken")
        assert second.refused(1)["code"] == "lease_not_held"
        first.lease("release")
        assert second.lease("acquire")["granted"]
        second.lease("release")
