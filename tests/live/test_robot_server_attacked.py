"""A Robot Server as a process, attacked on its own socket: it lives, and answers its KRC as before."""

import signal
import socket
import struct
import subprocess
import sys

import numpy as np
import pytest
from krc_side import FR, KRC, telegram

from deltaq_cell.load import load_cell
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.envelope import message_in
from deltaq_protocol.guarded import ServerState
from deltaq_protocol.session import subscribe_newest
from deltaq_services.guarded_realm import open_watching_session
from deltaq_services.robot_server.probe_trial import PROBE_RAD
from deltaq_testing.private_cell import write_private_cell

pytestmark = pytest.mark.service

OFF = np.array([np.deg2rad(1.4), 0, 0, 0, 0, 0])
PATIENCE_S = 300.0


class Attacked:
    """The process, its KRC's socket, one of somebody else, and what it publishes."""

    def __init__(self, folder):
        file = write_private_cell(folder)
        cell = load_cell(file)
        self.address = ("127.0.0.1", cell.robots["fr"].driver.port)
        command = [sys.executable, "-m", "deltaq_services.robot_server", "--cell", str(file), "--robot", "fr"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.printed = [self.line("ready")]
        self.krc, self.other = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(2))
        for sock in (self.krc, self.other):
            sock.connect(self.address)
            sock.settimeout(PATIENCE_S)
        self.ipoc = 1000
        self.session = open_watching_session(cell, "robot-server-fr")
        self.states = subscribe_newest(self.session, topics.SERVER_STATE.key(cell.cell, robot="fr"))

    def line(self, word):
        for line in self.process.stdout:
            if word in line:
                return line
        raise AssertionError(f"ended with {self.process.wait()} before it said {word!r}")

    def cycle(self, **changes):
        """One telegram of the KRC and its answer."""
        self.ipoc += 12
        self.krc.send(telegram(self.ipoc, **changes))
        while (told := KRC.decode(self.krc.recv(4096))).ipoc != self.ipoc:
            assert told.ipoc < self.ipoc  # an answer to an attack, which has waited here
        return told

    def state(self):
        """The next state, of a session that is believed."""
        while True:
            self.cycle()
            sample = self.states.try_recv()
            if sample is not None:
                return unpack(ServerState, message_in(sample.payload.to_bytes()))

    def count(self, counter, at_least=1):
        """Cycle until something was counted so often."""
        while self.state().counters.get(counter, 0) < at_least:
            assert self.process.poll() is None

    def close(self):
        for sock in (self.krc, self.other):
            sock.close()
        self.session.close()
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture
def attacked(tmp_path):
    attacked = Attacked(tmp_path)
    try:
        attacked.state()
        yield attacked
    finally:
        attacked.close()


# the mode of this session is probed all the while, since its KRC never moves; an attack of 1.4° is fifty times as much


def test_no_foreign_datagram_moves_the_robot_or_ends_the_process(attacked):
    for count in range(20):
        for sender in (attacked.other, attacked.krc):
            sender.send(telegram(attacked.ipoc + 12 * 5000 + 12 * count, FR.home + OFF))
            sender.send(telegram(attacked.ipoc + 12, FR.home + 50 * OFF))
            sender.send(telegram(attacked.ipoc + 12, FR.home + np.deg2rad(9_999_999.0)))
            sender.send(b"x" * 60_000)
            sender.send(b"")
        told = None
        while told is None or told.ipoc != attacked.ipoc:  # answers to the attacks may come first
            if told is None:
                attacked.ipoc += 12
                attacked.krc.send(telegram(attacked.ipoc))
            told = KRC.decode(attacked.krc.recv(4096))
            np.testing.assert_allclose(told.correction, 0.0, atol=PROBE_RAD)
    attacked.count("telegrams_second_krc", 20)
    state = attacked.state()
    assert "session_restarted" not in state.counters
    np.testing.assert_allclose(state.q_cmd, FR.home, atol=1e-6)


def test_a_sender_that_cannot_be_answered_is_dropped(attacked):
    try:
        raw = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_UDP)
    except PermissionError:
        pytest.skip("raw sockets are not allowed to this user")
    with raw:
        payload = telegram(attacked.ipoc + 12)
        header = struct.pack("!HHHH", 0, attacked.address[1], 8 + len(payload), 0)
        raw.sendto(header + payload, ("127.0.0.1", 0))
        attacked.count("telegrams_foreign")


def test_a_closed_krc_port_ends_no_process_and_the_krc_may_return_from_another(attacked):
    attacked.krc.send(telegram(attacked.ipoc + 12))
    attacked.krc.close()
    attacked.krc = socket.socket(type=socket.SOCK_DGRAM)
    attacked.krc.connect(attacked.address)
    attacked.krc.settimeout(0.1)
    while True:  # until the silence of the old port has lasted
        attacked.ipoc += 12
        attacked.krc.send(telegram(attacked.ipoc))
        try:
            told = KRC.decode(attacked.krc.recv(4096))
        except TimeoutError:
            assert attacked.process.poll() is None
            continue
        np.testing.assert_allclose(told.correction, 0.0, atol=PROBE_RAD)
        break
    attacked.krc.settimeout(PATIENCE_S)
    attacked.count("telegrams_second_krc")


def test_on_sigterm_the_robot_server_ends_the_motion_on_the_krc_and_exits(attacked):
    assert attacked.cycle().outputs == {"stop": False}
    attacked.process.send_signal(signal.SIGTERM)
    stops = 0
    while stops < 3:
        stops += attacked.cycle().outputs["stop"]
    assert attacked.process.wait(PATIENCE_S) == 0


def test_a_second_sigterm_ends_the_robot_server_at_once(attacked):
    attacked.process.send_signal(signal.SIGTERM)
    assert attacked.cycle()  # the first was taken, or is by the time the second comes
    attacked.process.send_signal(signal.SIGTERM)
    assert attacked.process.wait(PATIENCE_S) == 0
