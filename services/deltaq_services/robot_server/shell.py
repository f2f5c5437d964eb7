"""A Robot Server's process: its core and what it is connected to, for a robot on RSI and for one without a KRC."""

from __future__ import annotations

import logging
import secrets
import time
from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_protocol.real_time import SchedulingPriority, ask_for_real_time
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.crash_brake.core import PORT_PATIENCE_S
from deltaq_services.robot_server.crash_brake.record_maker import CrashRecordMaker
from deltaq_services.robot_server.crash_brake.watch import CrashWatch
from deltaq_services.robot_server.ending import Ending
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_file import crash_plan, sensor_codec
from deltaq_services.robot_server.krc_socket import KrcSocket
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.robot_server.rsi_loop import RsiLoop

_log = logging.getLogger(__name__)


def serve(cell: CellDescription, robot: str, ethernet_xml: Path | None) -> None:
    """Serve one robot until the process is told to end; it then brings the robot to rest first.

    Args:
        cell: the cell.
        robot: the robot's name.
        ethernet_xml: the RSI configuration that the KRC has loaded; None for a kinematic robot.
    """
    server = RobotServer(cell, robot, process=secrets.randbits(62))
    ask_for_real_time(SchedulingPriority.ROBOT_SERVER)
    driver = cell.robots[robot].driver
    if isinstance(driver, RsiDescription):
        assert ethernet_xml is not None  # the caller resolves it for this kind of driver
        _serve_rsi(cell, server, driver, ethernet_xml)
    else:
        _serve_kinematic(cell, server)


def _serve_rsi(cell: CellDescription, server: RobotServer, driver: RsiDescription, xml: Path) -> None:
    rsi = RsiDriver(sensor_codec(cell, server.robot, xml), cell, server.robot, server.counters)
    plan = crash_plan(cell, server.robot, xml)
    records = CrashRecordMaker(plan, rsi, tuple(driver.outputs))
    link = GuardedLink(cell, server.robot, server.counters)
    silence_s = cell.gate.krc_timeout_s
    try:
        with (
            KrcSocket(driver, silence_s, rsi, server.counters, PORT_PATIENCE_S) as krc,
            CrashWatch(plan, krc.socket, server.robot) as krc.watch,
        ):
            ending = Ending(server)
            loop = RsiLoop(server, rsi, krc, link, ending, silence_s, records)
            place = f"{driver.address}:{driver.port}"
            _log.info("ready: robot-server-%s waits for its KRC on %s", server.robot, place)
            loop.run()
    finally:
        link.close()


def _serve_kinematic(cell: CellDescription, server: RobotServer) -> None:
    """A robot that is no KUKA: this process keeps the time, and the robot is where it was sent."""
    link = GuardedLink(cell, server.robot, server.counters)
    ending = Ending(server)
    _log.info("ready: robot-server-%s keeps the time of a kinematic robot", server.robot)
    q = cell.robots[server.robot].home
    cycle_ms = round(cell.cycle_s * 1000)
    start_s = time.monotonic()
    cycle = 0
    try:
        while not ending.over:
            cycle += 1
            time.sleep(max(0.0, start_s + cycle * cell.cycle_s - time.monotonic()))
            now_s = time.monotonic()
            measured = Measurement(ipoc=cycle * cycle_ms, q=q, q_start=q if cycle == 1 else None)
            try:
                for message in link.heard():
                    server.take(message, now_s)
            except Exception as error:  # what has come is as if it were lost
                server.failed(error)
            (setpoint,) = server.take(measured, now_s)
            q = setpoint.q_cmd
            try:
                link.publish(server.state, now_s)
            except Exception as error:  # so is what was not said
                server.failed(error)
            server.containment.log_once(_log)
            ending.cycle_passed()
    finally:
        link.close()
