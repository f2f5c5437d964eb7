"""The loop of a Robot Server on RSI, over its real socket and link, step by step: nothing here waits for a clock."""

import logging
import signal
import socket
import threading

import numpy as np
import pytest
from injected import error_in_call
from krc_side import CELL, FR, KRC, XML, telegram

from deltaq_cell.identity import content_identity
from deltaq_protocol import topics
from deltaq_protocol.guarded import Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.guarded_realm import open_watching_session
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_socket import KrcSocket, RsiRobot
from deltaq_services.robot_server.rsi_driver import RsiDriver, sensor_codec
from deltaq_services.robot_server.shell import Ending, Loop
from deltaq_testing.private_cell import free_ports

WAITS_S = 300.0


class Rig:
    """A Robot Server's parts as the process puts them together, and a KRC."""

    def __init__(self) -> None:
        (krc_port,) = free_ports(1)
        robot = CELL.robots["fr"]
        driver = robot.driver.model_copy(update={"port": krc_port})
        robot = robot.model_copy(update={"driver": driver})
        cell = CELL.model_copy(update={"robots": {**CELL.robots, "fr": robot}})
        self.server = RobotServer(cell, "fr", process=1)
        self.rsi = RsiDriver(sensor_codec(cell, "fr", XML), cell, "fr", self.server.counters)
        self.link = GuardedLink(cell, "fr", self.server.counters)
        self.socket = KrcSocket(driver, 0.25, self.rsi, self.server.counters)
        robot = RsiRobot(self.rsi, self.socket, 0.25)
        self.loop = Loop(self.server, robot, self.link, Ending(self.server))
        self.krc = socket.socket(type=socket.SOCK_DGRAM)
        self.krc.settimeout(WAITS_S)
        self.krc.connect((driver.address, krc_port))
        self.ipoc, self.tick_s, self.now_s, self.correction = 1000, 0.012, 0.0, np.zeros(6)

    def cycle(self) -> bytes:
        """One telegram, read when it is there, the gate being heard; its answer, which the KRC follows."""
        identity = str(content_identity(CELL))
        self.server.take(Supervision(robot="fr", epoch=1, cycle=0, cell=identity), self.now_s)
        self.send()
        self.loop.cycle(self.now_s)
        answer = self.krc.recv(4096)
        self.correction = KRC.decode(answer).correction
        return answer

    def send(self) -> None:
        self.ipoc += 12
        self.now_s += self.tick_s
        self.krc.send(telegram(self.ipoc, FR.home + self.correction))

    def begin(self) -> None:
        """Until the session is believed."""
        while self.server.state is None:
            self.cycle()

    def close(self) -> None:
        self.krc.close()
        self.socket.__exit__(None, None, None)
        self.link.close()


@pytest.fixture
def rig():
    before = [(number, signal.getsignal(number)) for number in (signal.SIGTERM, signal.SIGINT)]
    rig = Rig()
    rig.begin()
    yield rig
    rig.close()
    for number, handler in before:
        signal.signal(number, handler)


def test_another_cycle_than_the_cells_is_logged_once_with_both_figures(rig, caplog):
    rig.tick_s = 0.004
    for _ in range(80):
        rig.cycle()
    (told,) = [message for message in caplog.messages if "the KRC ticks" in message]
    assert told.startswith(
        "the KRC ticks every 12.0 ms by its IPOC and 4.0 ms by the clock, the cell says 12.0 ms"
    )
    assert rig.server.state.reason is ReasonCode.CYCLE_MISMATCH


def test_a_telegram_is_answered_once_and_decided_on_once(rig):
    for _ in range(5):
        cycle = rig.server.state.cycle
        answer = rig.cycle()
        assert f"<IPOC>{rig.ipoc}</IPOC>".encode() in answer
        assert (rig.server.state.cycle, rig.server.state.ipoc) == (cycle + 1, rig.ipoc)
    rig.krc.setblocking(False)
    with pytest.raises(BlockingIOError):
        rig.krc.recv(4096)


@pytest.mark.parametrize("topic", [topics.ADMISSION, topics.SUPERVISION])
def test_waiting_messages_are_opened_before_the_answer(rig, topic):
    session = open_watching_session(CELL, "robot-server-fr")
    came = threading.Event()
    watching = rig.link._session.declare_subscriber(topic.key(CELL.cell, robot="fr"), lambda _: came.set())
    try:
        session.put(topic.key(CELL.cell, robot="fr"), b"whatever it is")
        assert came.wait(WAITS_S)
    finally:
        watching.undeclare()
        session.close()
    rig.cycle()
    assert rig.server.counters.keys() & {"invalid_admission", "invalid_supervision"}


def test_a_reply_that_the_guard_refuses_repeats_the_last_correction_and_holds_the_robot(rig):
    while rig.server.detail:
        before = rig.cycle()
    assert rig.server.state.phase is Phase.READY
    rig.rsi._most = [-1.0] * 6  # no step at all is small enough
    again = rig.cycle()
    assert again.partition(b"<IPOC>")[0] == before.partition(b"<IPOC>")[0]
    assert rig.server.state.reason is ReasonCode.REPLY_REFUSED
    assert rig.server.state.phase is Phase.HELD


@pytest.mark.parametrize(
    ("place", "answers"),
    [
        ("deltaq_services.robot_server.session", False),  # a telegram is read
        ("deltaq_services.robot_server.guards", True),  # a cycle is decided
        ("deltaq_services.robot_server.reply_guard", False),  # a reply is made
        ("deltaq_services.rate_limit", True),  # the state is published
    ],
)
def test_an_error_anywhere_in_the_loop_holds_the_robot_and_the_next_telegram_is_answered(
    rig, place, answers, caplog
):
    while rig.server.detail:
        rig.cycle()
    assert rig.server.state.phase is Phase.READY
    with error_in_call(1, place) as calls:
        if answers:
            rig.cycle()
        else:
            rig.send()
            rig.loop.cycle(rig.now_s)
    assert calls.count == 1
    rig.loop._server.containment.log_once(logging.getLogger("test"))
    assert "InjectedError" in caplog.text
    for _ in range(10):
        rig.cycle()
    assert rig.server.counters["internal_errors"] == 1
    assert (rig.server.state.phase, rig.server.state.reason) == (Phase.HELD, ReasonCode.INTERNAL_ERROR)
    resets = rig.server.state.resets + 1
    identity = str(content_identity(CELL))
    order = Supervision(robot="fr", epoch=1, cycle=0, resets=resets, cell=identity)
    rig.server.take(order, rig.now_s)
    rig.send()
    rig.loop.cycle(rig.now_s)
    assert rig.server.state.phase is Phase.READY
