"""The console on a running cell: driving, STOP, and whatever dies meanwhile; one cell for all of it."""

import json
import os
import signal
import socket
import time
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from websockets.sync.client import connect as open_websocket

from deltaq_deploy.launch.cell_connection import connect
from deltaq_protocol.messages import Phase

pytestmark = pytest.mark.live

TIMEOUT_S = 300.0
SPEED = (0.0, 0.0, 0.0, 0.0, 0.0, 0.5)


class Browser:
    """What a browser does, and what it is told."""

    def __init__(self, socket):
        self.socket = socket
        self.status = {}
        self._acks = {}
        self._ids = 0
        self.send("ping")
        self.until(lambda: self.status.get("hli"))

    def send(self, kind, **fields):
        self._ids += 1
        command = {"type": kind, "id": f"c{self._ids}", "sent_ms": 1000.0 * time.monotonic(), **fields}
        self.socket.send(json.dumps(command))
        return command["id"]

    def until(self, reached):
        """Read what comes until this holds."""
        deadline = time.monotonic() + TIMEOUT_S
        while not reached():
            assert time.monotonic() < deadline, (self.status, self._acks)
            message = self.socket.recv(timeout=TIMEOUT_S)
            if isinstance(message, bytes):
                continue
            message = json.loads(message)
            if message["type"] == "status":
                self.status = message
            elif message["type"] == "ack":
                self._acks[message["id"]] = message

    def does(self, kind, **fields):
        """Send a command, and wait until it is done."""
        command = self.send(kind, **fields)
        self.until(lambda: self._acks.get(command, {}).get("outcome") not in (None, "asked"))
        assert self._acks[command]["outcome"] == "done", self._acks[command]

    def robot(self):
        return self.status["robots"]["fr"]

    def moves(self, cell):
        """Take fr, and wish to move until it does."""
        self.does("lease", robot="fr", action="take")
        before = cell.q()
        deadline = time.monotonic() + TIMEOUT_S
        while abs(cell.q()[5] - before[5]) < 0.05:
            assert time.monotonic() < deadline
            self.does("jog", robot="fr", wish=SPEED)


@contextmanager
def browser(cell, name):
    with open_websocket(f"{cell.url.replace('http', 'ws')}/live?name={name}") as opened:
        yield Browser(opened)


@pytest.fixture(scope="module")
def cell(shared_stack):
    stack = shared_stack.renewed()

    def robot():
        with connect(stack.cell, "test") as running:
            return running.status().robots["fr"]

    def until(reached):
        deadline = time.monotonic() + TIMEOUT_S
        while not reached(seen := robot()):
            assert time.monotonic() < deadline, seen

    return SimpleNamespace(
        launcher=stack.launcher, url=stack.serve_console(), robot=robot, until=until, q=lambda: robot().q
    )


def at_rest_and_free(robot):
    """Neither moved nor held: it was brought to rest and released, and nobody was lost."""
    return robot.phase is Phase.READY and robot.lease.holder is None


@pytest.mark.nightly
def test_a_stop_in_motion_ends_at_rest_and_a_reset_ends_it(cell):
    with browser(cell, "desk") as desk:
        desk.moves(cell)
        desk.does("stop")
        desk.until(lambda: desk.status["stop"] == "at_rest")
        q = cell.q()
        assert cell.robot().phase is Phase.HELD
        assert (desk.status["wanted_by"], desk.robot()["reason"]) == ("desk", "operator_stop")
        for robot in ("fr", "gr"):
            desk.does("reset", robot=robot)
        desk.until(lambda: desk.status["stop"] == "none")
        assert cell.q() == pytest.approx(q, abs=1e-4)
        desk.does("lease", robot="fr", action="release")
    cell.until(at_rest_and_free)


def test_a_page_closed_in_motion_leaves_the_robot_at_rest_and_free(cell):
    with browser(cell, "desk") as desk:
        desk.moves(cell)
        desk.socket.socket.shutdown(socket.SHUT_RDWR)
    cell.until(at_rest_and_free)
    with browser(cell, "tower") as tower:
        tower.does("lease", robot="fr", action="take")
        assert cell.robot().lease.holder == "tower (console)"


def test_the_console_survives_a_restart_of_the_hli(cell):
    with browser(cell, "desk") as desk:
        os.killpg(cell.launcher.children["hli"].pid, signal.SIGKILL)
        # a query may fail before the newest state has become old
        desk.until(lambda: not desk.status["hli"] and "old" in desk.robot()["text"])
        cell.launcher.restart("hli")
        desk.until(lambda: desk.status["hli"] and "old" not in desk.robot()["text"])
        if desk.robot()["phase"] == "held":
            desk.does("reset", robot="fr")
        desk.moves(cell)


def test_a_console_that_is_killed_in_motion_leaves_the_robot_at_rest_and_free(cell):
    cell.until(at_rest_and_free)
    with browser(cell, "desk") as desk:
        desk.moves(cell)
        os.killpg(cell.launcher.children["console"].pid, signal.SIGKILL)
        cell.until(at_rest_and_free)
