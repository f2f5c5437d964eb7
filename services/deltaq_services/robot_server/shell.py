"""The loop of a Robot Server: the KRC's datagram is its only clock.

One blocking loop in one Python thread: receive, answer at once, and publish after. Anything else costs cycles.
"""

from __future__ import annotations

import math
import secrets
import select
import socket
import time
from pathlib import Path

from deltaq_cell.description import CellDescription
from deltaq_cell.description import RsiDriver as RsiDescription
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.rsi import AxisMap, SensorCodec, TelegramError, load_ethernet_xml
from deltaq_services.process import ask_for_real_time
from deltaq_services.robot_server.core import Measurement, RobotServer
from deltaq_services.robot_server.link import Link
from deltaq_services.robot_server.rsi_driver import RsiDriver

_DATAGRAM_BYTES = 65_536
_MOST_WAITING = 1024
"""Datagrams drained before one is answered: more than a socket holds, so that nothing but a flood is cut short."""

_REAL_TIME_PRIORITY = 20
"""Above the gate's, so that a telegram is answered while the gate decides."""


def serve(cell: CellDescription, robot: str, ethernet_xml: Path | None) -> None:
    """Serve one robot until the process is told to end.

    Args:
        cell: the cell.
        robot: the robot's name.
        ethernet_xml: the RSI configuration that the KRC has loaded; None for a kinematic robot.
    """
    server = RobotServer(cell, robot, process=secrets.randbits(62))
    ask_for_real_time(_REAL_TIME_PRIORITY)
    driver = cell.robots[robot].driver
    if isinstance(driver, RsiDescription):
        assert ethernet_xml is not None  # the caller resolves it for this kind of driver
        _serve_rsi(cell, server, driver, ethernet_xml)
    else:
        _serve_kinematic(cell, server)


def sensor_codec(cell: CellDescription, robot: str, ethernet_xml: Path) -> SensorCodec:
    """The PC's telegrams of a robot, from the file that its KRC has loaded."""
    description = cell.robots[robot]
    assert isinstance(description.driver, RsiDescription)  # asked only of robots that speak RSI
    return SensorCodec(
        load_ethernet_xml(ethernet_xml),
        AxisMap.of(description.joint_names, description.units, description.driver.krc),
        description.driver.inputs,
        description.driver.outputs,
    )


def _serve_rsi(cell: CellDescription, server: RobotServer, driver: RsiDescription, xml: Path) -> None:
    rsi = RsiDriver(sensor_codec(cell, server.robot, xml), cell.cycle_s)
    link = Link(cell, server.robot, server.counters)
    with _bound(driver) as sock:
        incoming = select.poll()
        incoming.register(sock, select.POLLIN)
        timeout_ms = math.ceil(cell.gate.krc_timeout_s * 1000)
        print(
            f"ready: robot-server-{server.robot} waits for its KRC on {driver.address}:{driver.port}",
            flush=True,
        )
        try:
            while True:
                if not incoming.poll(timeout_ms):
                    now_s = time.monotonic()
                    server.krc_silent(now_s)
                    link.publish(server.state, now_s, "KRC silent")
                    continue
                datagram, krc = _newest(sock, server)
                arrived_s = time.monotonic()
                measured = _read(rsi, datagram, server)
                if measured is None:
                    if rsi.opening_reply is not None:
                        sock.sendto(rsi.opening_reply, krc)
                    link.publish(None, arrived_s, "waiting for a first position")
                    continue
                q_cmd = server.cycle(measured, arrived_s, link.admission(), link.supervision())
                sock.sendto(rsi.reply(q_cmd, server.outputs), krc)
                link.publish(server.state, arrived_s)
        finally:
            link.close()


def _serve_kinematic(cell: CellDescription, server: RobotServer) -> None:
    """A robot that is no KUKA: this process keeps the time, and the robot is where it was sent."""
    link = Link(cell, server.robot, server.counters)
    print(f"ready: robot-server-{server.robot} keeps the time of a kinematic robot", flush=True)
    q = cell.robots[server.robot].home
    cycle_ms = round(cell.cycle_s * 1000)
    start_s = time.monotonic()
    try:
        for cycle in range(1, 2**62):
            time.sleep(max(0.0, start_s + cycle * cell.cycle_s - time.monotonic()))
            now_s = time.monotonic()
            measured = Measurement(ipoc=cycle * cycle_ms, q=q, q_start=q if cycle == 1 else None)
            q = server.cycle(measured, now_s, link.admission(), link.supervision())
            link.publish(server.state, now_s)
    finally:
        link.close()


def _bound(driver: RsiDescription) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    try:
        sock.bind((driver.address, driver.port))
    except OSError as error:
        sock.close()
        raise ServiceUnreachableError(
            f"cannot listen for RSI on UDP {driver.address}:{driver.port}: {error.strerror}; "
            "is another Robot Server running, or the address not this machine's?"
        ) from error
    return sock


def _newest(sock: socket.socket, server: RobotServer) -> tuple[bytes, tuple[str, int]]:
    """The newest of the datagrams that have arrived; older ones are past their time and are counted."""
    newest: tuple[bytes, tuple[str, int]] = sock.recvfrom(_DATAGRAM_BYTES)
    for _ in range(_MOST_WAITING):
        try:
            newest = sock.recvfrom(_DATAGRAM_BYTES)
        except BlockingIOError:
            break
        server.counters["telegrams_skipped"] += 1
    return newest


def _read(rsi: RsiDriver, datagram: bytes, server: RobotServer) -> Measurement | None:
    try:
        return rsi.read(datagram)
    except TelegramError as error:
        server.counters["telegrams_garbled"] += 1
        if server.counters["telegrams_garbled"] == 1:
            print(f"first garbled telegram: {error}", flush=True)
        return None
