"""The KRC's side of one robot's RSI, telegram by telegram, in virtual time, before a Robot Server's driver and core."""

from collections import Counter

import numpy as np
from small_cell import admission_after

from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.identity import content_identity
from deltaq_cell.load import load_cell
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.guarded import Supervision
from deltaq_protocol.rsi import AxisMap, KrcCodec, KrcReport, load_ethernet_xml
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.rsi_driver import RsiDriver, sensor_codec
from deltaq_services.robot_server.session import CONFIRMATIONS

CELL = load_cell("lab")
FR = CELL.robots["fr"]
XML = resolve_near(find_cell("lab"), FR.driver.ethernet_xml)
AXES = AxisMap.of(FR.joint_names, FR.units, FR.driver.krc)


def codec_of(xml):
    """The KRC's side of a file."""
    outputs = {**FR.driver.outputs, "stop": FR.driver.stop}
    return KrcCodec(load_ethernet_xml(xml), AXES, FR.driver.inputs, outputs, 4)


KRC = codec_of(XML)
EPOCH = 7
MAX_DV = FR.max_acceleration * CELL.cycle_s**2
_POSE = (0.0,) * 6


def telegram(ipoc, q=FR.home, programmed=FR.home, delay=0, codec=KRC):
    return codec.encode(KrcReport(ipoc, q, programmed, _POSE, _POSE, delay, dict.fromkeys(FR.inputs, False)))


class KrcSide:
    """A KRC that sends a telegram a cycle and takes the correction of each answer at once.

    Attributes:
        q_programmed: where its session began; correction: the last that it took.
        time_s, ipoc: of its clock.
        stop: whether it was told to end the motion.
        resets, order: what the gate orders.
    """

    def __init__(self, step=12, cell=CELL, xml=XML):
        self.cell = cell
        self._identity = str(content_identity(cell))
        self.server = RobotServer(cell, "fr", process=1)
        self.counters: Counter[str] = self.server.counters
        self.driver = RsiDriver(sensor_codec(cell, "fr", xml), cell, "fr", self.counters)
        self.codec = codec_of(xml)
        self.step = step
        self.ipoc = 1000
        self.time_s = 0.0
        self.q_programmed = FR.home.copy()
        self.correction = np.zeros(6)
        self.stop = False
        self.resets = 0
        self.order = None
        self.missed = False

    @property
    def q(self):
        return self.q_programmed + self.correction

    def tick(self, cycles=1):
        self.time_s += cycles * self.cell.cycle_s
        self.ipoc = (self.ipoc + cycles * self.step) % 2**32

    def own(self, **changes):
        """The KRC's true telegram of this cycle."""
        return telegram(
            self.ipoc,
            changes.pop("q", self.q),
            changes.pop("programmed", self.q_programmed),
            codec=self.codec,
            **changes,
        )

    def answer(self, datagram, admission=None):
        """The server's answer to a datagram in bytes, the gate being heard; None if there is none."""
        supervision = Supervision(
            robot="fr",
            epoch=EPOCH,
            cycle=0,
            stop=self.order,
            resets=self.resets,
            cell=self._identity,
        )
        measured = self.driver.read(datagram, self.time_s)
        if measured is None:
            return self.driver.unmoved
        self.missed = measured.missed_last
        q_cmd = self.server.cycle(measured, self.time_s, admission, supervision)
        answer = self.driver.reply(q_cmd, self.server.outputs, self.server.motion_stop)
        if self.driver.fault is not None:
            self.server.reply_refused(self.driver.q_sent)
        return answer

    def hand(self, datagram, admission=None):
        """Hand the server a datagram; returns its answer as the KRC reads it, or None."""
        answer = self.answer(datagram, admission)
        if answer is None:
            return None
        told = KRC.decode(answer)
        if told.ipoc == self.ipoc:  # any other is late to a KRC, and changes nothing
            self.correction, self.stop = told.correction, told.outputs["stop"]
        return told

    def cycle(self, admission=None, **changes):
        """One cycle of the KRC with its own telegram."""
        self.tick()
        return self.hand(self.own(**changes), admission)

    def admission(self, increment):
        """An admission that follows what the server does."""
        cycles = brake_cycles(increment, FR.max_acceleration * self.cell.cycle_s**2)
        return admission_after(self.server.state, increment, cycles, epoch=EPOCH)

    def run_up(self, cycles):
        """Accelerate all joints for some cycles."""
        for count in range(1, cycles + 1):
            self.cycle(self.admission(count * MAX_DV))
        return self

    def drive(self):
        """Drive some degrees away from where the session began, and come to rest."""
        return self.run_up(4).until(lambda: not any(self.server.state.dq))

    def begin(self):
        """Cycle until the session is believed and, where it is, its mode known."""
        for _ in range(CONFIRMATIONS):
            self.cycle()
        return self.probed() if self.server.state else self

    def probed(self):
        """Cycle until the mode of the session is known."""

        def is_known():
            assert self.server.detail in ("", "probes the mode of corrections")
            return not self.server.detail

        return self.until(is_known)

    def until(self, happens):
        """Cycle until something happens, which it has to within a thousand cycles."""
        for _ in range(1000):
            if happens():
                return self
            self.cycle()
        raise AssertionError("it does not happen")
