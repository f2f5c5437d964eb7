"""The loop of a Robot Server on RSI, over its real socket and link, step by step: nothing here waits for a clock."""

from __future__ import annotations

import math
import signal
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest
from krc_side import CELL, FR, KRC, XML, preparing, telegram

from deltaq_cell.identity import content_identity
from deltaq_launch.private_cell import free_ports
from deltaq_protocol import topics
from deltaq_protocol.guarded import Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.session import open_session
from deltaq_services.robot_server.arrivals import Arrivals
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.ending import Ending
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_file import preparation, sensor_codec
from deltaq_services.robot_server.krc_socket import KrcSocket
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.robot_server.rsi_loop import RsiLoop

WAITS_S = 10.0


class Rig:
    """A Robot Server's parts as the process puts them together, and a KRC."""

    def __init__(self) -> None:
        link_port, krc_port = free_ports(2)
        robot = CELL.robots["fr"]
        driver = robot.driver.model_copy(update={"port": krc_port})
        self.endpoint = f"tcp/127.0.0.1:{link_port}"
        robot = robot.model_copy(update={"server": self.endpoint, "driver": driver})
        cell = CELL.model_copy(update={"robots": {**CELL.robots, "fr": robot}})
        self.server = RobotServer(cell, "fr", process=1)
        self.rsi = RsiDriver(sensor_codec(cell, "fr", XML), cell, "fr", self.server.counters)
        self.link = GuardedLink(cell, "fr", self.server.counters)
        self.socket = KrcSocket(driver, 0.25, self.rsi, self.server.counters)
        prepares = preparation(preparing(cell), self.server, self.rsi, XML)
        self.loop = RsiLoop(
            self.server, self.rsi, self.socket, self.link, Ending(self.server), prepares, cell.cycle_s, 0.25
        )
        self.krc = socket.socket(type=socket.SOCK_DGRAM)
        self.krc.settimeout(WAITS_S)
        self.krc.connect((driver.address, krc_port))
        self.ipoc, self.now_s, self.correction = 1000, 0.0, np.zeros(6)

    def cycle(self) -> bytes:
        """One telegram, read when it is there, the gate being heard; its answer, which the KRC follows."""
        identity = str(content_identity(CELL))
        self.server.take(Supervision(robot="fr", epoch=1, cycle=0, cell=identity), self.now_s)
        self.send()
        self.loop._read(self.now_s)
        answer = self.krc.recv(4096)
        self.correction = KRC.decode(answer).correction
        return answer

    def send(self) -> None:
        self.ipoc += 12
        self.now_s += 0.012
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


def test_the_prepared_reply_is_sent_and_its_telegram_decided_on_once(rig):
    for count in range(1, 20):
        rig.loop._prepare(rig.loop._preparation, rig.now_s)
        prepared = rig.loop._prepared
        cycle = rig.server.state.cycle
        rig.send()
        rig.loop._answer(prepared)
        assert rig.krc.recv(4096) == prepared.reply
        assert rig.server.state.cycle == cycle + 1
        assert rig.server.state.ipoc == rig.ipoc
        assert rig.server.counters["prepared_replies"] == count
    rig.krc.setblocking(False)
    with pytest.raises(BlockingIOError):
        rig.krc.recv(4096)


def test_an_unexpected_telegram_is_answered_once_as_decided(rig):
    rig.loop._prepare(rig.loop._preparation, rig.now_s)
    rig.ipoc += 12  # one was lost
    rig.send()
    rig.loop._answer(rig.loop._prepared)
    assert f"<IPOC>{rig.ipoc}</IPOC>".encode() in rig.krc.recv(4096)
    assert rig.server.counters["prepared_replies"] == 0
    rig.krc.setblocking(False)
    with pytest.raises(BlockingIOError):
        rig.krc.recv(4096)


@pytest.mark.parametrize("topic", [topics.ADMISSION, topics.SUPERVISION])
def test_what_the_gate_says_after_the_preparation_is_heard_before_the_answer(rig, topic):
    rig.loop._prepare(rig.loop._preparation, rig.now_s)
    came = threading.Event()
    arrivals = rig.loop._arrivals
    arrivals.one = lambda: (Arrivals.one(arrivals), came.set())
    session = open_session(connect=[rig.endpoint], must_connect=True)
    try:
        session.put(topic.key(CELL.cell, robot="fr"), b"whatever it is")
        assert came.wait(WAITS_S)
    finally:
        session.close()
    rig.send()
    rig.loop._answer(rig.loop._prepared)
    assert f"<IPOC>{rig.ipoc}</IPOC>".encode() in rig.krc.recv(4096)
    assert rig.server.counters["prepared_replies"] == 0
    assert rig.server.counters.keys() & {"forged_admission", "forged_supervision"}
    rig.loop._prepare(rig.loop._preparation, rig.now_s)
    rig.send()
    rig.loop._answer(rig.loop._prepared)
    rig.krc.recv(4096)
    assert rig.server.counters["prepared_replies"] == 1  # it was heard, and makes no later reply void


def test_while_the_gate_goes_on_speaking_a_reply_is_prepared_anew_and_not_for_ever(rig):
    prepared = []
    while rig.loop._prepare_s < math.inf:
        rig.loop._prepare(rig.loop._preparation, rig.now_s)
        prepared.append(rig.loop._prepared)
        rig.loop._arrivals.one()
        rig.loop._answer(rig.loop._prepared)
        assert rig.loop._prepared is None
    assert len({each.reply for each in prepared}) == 1
    assert len(prepared) == 3
    rig.send()
    rig.loop._read(rig.now_s)
    assert rig.krc.recv(4096) == prepared[0].reply
    assert rig.loop._prepare_s < math.inf
    rig.loop._prepare(rig.loop._preparation, rig.now_s)
    rig.loop._arrivals.one()
    rig.loop._answer(rig.loop._prepared)
    assert rig.loop._prepare_s < math.inf  # in each cycle as often


def test_a_prepared_reply_that_was_wrong_holds_the_robot_where_it_was_sent(rig):
    while rig.server.detail:
        rig.cycle()
    assert rig.server.state.phase is Phase.READY
    rig.loop._prepare(rig.loop._preparation, rig.now_s)
    right = rig.loop._prepared
    correction = (*right.correction[:5], right.correction[5] + 1e-4)
    other = rig.rsi._codec.encode(rig.ipoc + 12, np.array(correction))
    rig.send()
    rig.loop._answer(replace(right, correction=correction, reply=other))
    assert rig.krc.recv(4096) == other
    assert rig.server.counters["prepared_replies_wrong"] == 1
    assert rig.server.state.reason is ReasonCode.REPLY_REFUSED
    assert rig.server.state.phase is Phase.HELD
    assert rig.server.state.q_reset[5] - rig.server.state.q_cmd[5] == pytest.approx(1e-4)
    rig.now_s = rig.socket.came_s
    again = rig.cycle()
    assert again.partition(b"<IPOC>")[0] == other.partition(b"<IPOC>")[0]
