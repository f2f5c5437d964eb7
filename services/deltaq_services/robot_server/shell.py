"""A Robot Server's process: its core and what it is connected to, for a robot on RSI and for one without a KRC."""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Mapping
from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_protocol.real_time import SchedulingPriority, ask_for_real_time
from deltaq_services.containment import Containment
from deltaq_services.robot_server.core import Ending, RobotServer
from deltaq_services.robot_server.crash_brake.core import PORT_PATIENCE_S
from deltaq_services.robot_server.crash_brake.watch import CrashRecordMaker, CrashWatch
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_socket import KrcSocket
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver, crash_plan, sensor_codec


class RsiLoop:
    """Answers one KRC until the process may end: its datagram is the only clock.

    One thread, and one cycle of it: wait for the telegram; take what has come from the gate, decide, and send the
    reply; publish. An error that nobody foresaw in any of them holds the robot: a telegram that cannot be read is none,
    a reply that cannot be made is none that was sent. Only a core that cannot even brake ends the process.

    Args:
        server: the core.
        rsi: the driver.
        krc: the socket.
        link: to the gate.
        ending: of the process.
        silence_s: after which a KRC counts as silent.
        records: makes those that are left before replies; None if none are.
    """

    def __init__(
        self,
        server: RobotServer,
        rsi: RsiDriver,
        krc: KrcSocket,
        link: GuardedLink,
        ending: Ending,
        silence_s: float,
        records: CrashRecordMaker | None = None,
    ) -> None:
        self._server, self._rsi, self._krc = server, rsi, krc
        self._link, self._ending = link, ending
        self._silence_s, self._records = silence_s, records
        self._silent_s = 0.0
        self._cycle_fault = ""
        self._driver = Containment(lambda: (rsi, rsi.session))

    def run(self) -> None:
        """Answer telegrams until the process may end."""
        self._silent_s = time.monotonic() + self._silence_s
        while not self._ending.over:
            self._krc.wait(self._silent_s - time.monotonic())
            self._read(time.monotonic())
            self._server.containment.log_once(_log)
            if self._krc.watch is not None:
                self._krc.watch.mend(time.monotonic())

    def _read(self, now_s: float) -> None:
        """Answer the telegram that has come, if one has, or notice that the KRC is silent."""
        self._driver.remember()
        try:
            measured = self._krc.read(now_s)
        except Exception as error:
            self._driver.put_back()
            self._server.failed(error)
            measured = None
        if measured is not None:
            self._silent_s = now_s + self._silence_s
            self._decide(measured, now_s)
            self._publish(now_s)
            self._ending.cycle_passed()
            self._warn(measured.cycle_fault)
            return
        if self._rsi.unmoved is not None:
            self._krc.send(self._rsi.unmoved)
        if now_s >= self._silent_s:
            self._silent_s = now_s + self._silence_s
            self._server.krc_silent(now_s)
            self._publish(now_s, "KRC silent")
            self._ending.krc_silent()
        else:
            try:
                self._link.publish(None, now_s, lambda: _told("waiting for a position", self._krc.detail))
            except Exception as error:
                self._server.failed(error)

    def _publish(self, now_s: float, what: str = "") -> None:
        try:
            state = self._server.state
            self._link.publish(state, now_s, lambda: _told(what, self._server.detail, self._krc.detail))
        except Exception as error:
            self._server.failed(error)

    def _warn(self, cycle_fault: str) -> None:
        """Log why the KRC's cycle is not the cell's, once while it is not."""
        if cycle_fault and not self._cycle_fault:
            _log.warning("%s", cycle_fault)
        self._cycle_fault = cycle_fault

    def _decide(self, measured: Measurement, now_s: float) -> None:
        try:
            for message in self._link.heard():
                self._server.take(message, now_s)
        except Exception as error:
            self._server.failed(error)
        self._server.guarded = self._krc.is_guarded
        (setpoint,) = self._server.take(measured, now_s)
        stop = self._ending.stop or setpoint.motion_stop
        try:
            reply = self._rsi.reply(setpoint.q_cmd, setpoint.outputs, stop)
        except Exception as error:
            self._server.failed(error)
            self._server.reply_refused(self._rsi.q_sent)
            return
        try:
            self._krc.send_setpoint(reply, self._recorded(measured.ipoc, setpoint.outputs))
        except Exception as error:  # to the KRC it is a lost reply
            self._server.failed(error)
        if self._rsi.fault is not None:
            self._server.reply_refused(self._rsi.q_sent)

    def _recorded(self, ipoc: int, outputs: Mapping[str, bool]) -> bytes | None:
        """The record to leave before a reply."""
        if self._records is None:
            return None
        return self._records.body(self._records.of_last(self._krc.newest, ipoc, outputs, self._server.motion))


def _told(*details: str) -> str:
    return "; ".join(filter(None, details))


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
