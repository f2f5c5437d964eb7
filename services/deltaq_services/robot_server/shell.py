"""A Robot Server's process: its core and its connections, for a robot on RSI and for one without a KRC."""

import logging
import secrets
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.real_time import SchedulingPriority, ask_for_real_time, place_of_robot
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.robot_server.core import Ending, RobotServer
from deltaq_services.robot_server.crash_brake.core import PORT_PATIENCE_S
from deltaq_services.robot_server.crash_brake.watch import CrashRecordMaker, CrashWatch
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_socket import KrcSocket, RsiRobot
from deltaq_services.robot_server.measurement import Driver, Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver, crash_plan, sensor_codec


class Loop:
    """Runs one robot cycle by cycle until the process may end.

    One thread; its cycle: wait for the robot; take the gate's messages, decide, and send; publish. An unexpected
    error in any step holds the robot: an unreadable message is ignored, a failed reply is not sent. Only a core that
    cannot even brake ends the process.

    Args:
        server: the core.
        driver: the robot.
        link: to the gate.
        ending: of the process.
    """

    def __init__(self, server: RobotServer, driver: Driver, link: GuardedLink, ending: Ending) -> None:
        self._server, self._driver = server, driver
        self._link, self._ending = link, ending
        self._cycle_fault = ""

    def run(self) -> None:
        """Serve the robot until the process may end."""
        while not self._ending.over:
            self.cycle(self._driver.wait())
            self._server.containment.log_once(_log)
            self._driver.mend(time.monotonic())

    def cycle(self, now_s: float) -> None:
        """Decide on the robot's report, or notice that the robot is lost."""
        try:
            measured = self._driver.read(now_s)
        except Exception as error:
            self._server.failed(error)
            measured = None
        if measured is not None:
            self._decide(measured, now_s)
            self._publish(now_s)
            self._ending.cycle_passed()
            self._warn(measured.cycle_fault)
        elif self._driver.is_lost(now_s):
            self._server.krc_silent(now_s)
            self._publish(now_s, "KRC silent")
            self._ending.krc_silent()
        else:
            try:
                self._link.publish(None, now_s, lambda: _told("waiting for a position", self._driver.detail))
            except Exception as error:
                self._server.failed(error)

    def _publish(self, now_s: float, what: str = "") -> None:
        try:
            state = self._server.state
            self._link.publish(state, now_s, lambda: _told(what, self._server.detail, self._driver.detail))
        except Exception as error:
            self._server.failed(error)

    def _warn(self, cycle_fault: str) -> None:
        """Log why the robot's cycle is not the cell's, once while it is not."""
        if cycle_fault and not self._cycle_fault:
            _log.warning("%s", cycle_fault)
        self._cycle_fault = cycle_fault

    def _decide(self, measured: Measurement, now_s: float) -> None:
        server, driver = self._server, self._driver
        try:
            for message in self._link.heard():
                server.take(message, now_s)
        except Exception as error:  # the message counts as lost
            server.failed(error)
        server.guarded = driver.is_guarded
        (setpoint,) = server.take(measured, now_s)
        try:
            taken = driver.write(setpoint.q_cmd, setpoint.outputs, self._ending.stop or setpoint.motion_stop)
        except Exception as error:
            server.failed(error)
            server.reply_refused(driver.q_sent)
            return
        try:
            driver.send(server.motion)
        except Exception as error:  # to the robot it is lost
            server.failed(error)
        if not taken:
            server.reply_refused(driver.q_sent)


class KinematicRobot:
    """Driver of a robot without a controller: this process keeps the time, and the robot is at its setpoint.

    Args:
        q: (n,) where it begins [rad or m].
        cycle_s: sample time.
    """

    is_guarded = True
    detail = ""

    def __init__(self, q: Array, cycle_s: float) -> None:
        self.q_sent = q
        self._cycle_s, self._start_s, self._cycles = cycle_s, time.monotonic(), 0

    def wait(self) -> float:
        """Sleep until the next cycle."""
        self._cycles += 1
        time.sleep(max(0.0, self._start_s + self._cycles * self._cycle_s - time.monotonic()))
        return time.monotonic()

    def read(self, _now_s: float) -> Measurement:
        """Report the setpoint as the measured configuration."""
        q = self.q_sent
        ipoc = self._cycles * round(self._cycle_s * 1000)
        return Measurement(ipoc=ipoc, q=q, q_start=q if self._cycles == 1 else None)

    def is_lost(self, _now_s: float) -> bool:
        """Never."""
        return False

    def write(self, q_cmd: Array, _outputs: Mapping[str, bool], _stop: bool) -> bool:
        """Move at once: the setpoint becomes the measured configuration."""
        self.q_sent = q_cmd
        return True

    def send(self, motion: SetpointMotion) -> None:
        """Does nothing."""

    def mend(self, now_s: float) -> None:
        """Does nothing."""


def _told(*details: str) -> str:
    return "; ".join(filter(None, details))


_log = logging.getLogger(__name__)


def serve(cell: CellDescription, robot: str, ethernet_xml: Path | None) -> None:
    """Serve one robot until SIGTERM or SIGINT; the robot is brought to rest first.

    Args:
        cell: the cell.
        robot: the robot's name.
        ethernet_xml: the RSI configuration that the KRC has loaded; None for a kinematic robot.
    """
    server = RobotServer(cell, robot, process=secrets.randbits(62))
    ask_for_real_time(SchedulingPriority.ROBOT_SERVER, place_of_robot(cell.robots, robot))
    link = GuardedLink(cell, robot, server.counters)
    description = cell.robots[robot].driver
    try:
        with ExitStack() as stack:
            if isinstance(description, RsiDescription):
                assert ethernet_xml is not None  # the caller resolves it for this kind of driver
                driver: Driver = _rsi(cell, server, description, ethernet_xml, stack)
                waits = f"waits for its KRC on {description.address}:{description.port}"
            else:
                driver = KinematicRobot(cell.robots[robot].home, cell.cycle_s)
                waits = "drives a kinematic robot"
            loop = Loop(server, driver, link, Ending(server))
            _log.info("ready: robot-server-%s %s", robot, waits)
            loop.run()
    finally:
        link.close()


def _rsi(
    cell: CellDescription, server: RobotServer, description: RsiDescription, xml: Path, stack: ExitStack
) -> RsiRobot:
    """A robot on RSI, whose socket and whose crash brake last as long as `stack`."""
    rsi = RsiDriver(sensor_codec(cell, server.robot, xml), cell, server.robot, server.counters)
    plan = crash_plan(cell, server.robot, xml)
    silence_s = cell.gate.krc_timeout_s
    krc = stack.enter_context(KrcSocket(description, silence_s, rsi, server.counters, PORT_PATIENCE_S))
    krc.watch = stack.enter_context(CrashWatch(plan, krc.socket, server.robot))
    return RsiRobot(rsi, krc, silence_s, CrashRecordMaker(plan, rsi, tuple(description.outputs)))
