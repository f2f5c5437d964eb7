"""RSI as the Robot Server speaks it: telegrams to measurements, setpoints to absolute corrections.

An absolute correction is an offset from where the programmed path stands, so rounding to the telegram's decimals
never accumulates. With `DEF_ASPos` in the telegram that position is known even if this process joins a running
session; without it, the first measured position is taken for it. It is fixed for a session.

Only the setpoint moves the robot: any other answer repeats the correction that the KRC has already.
"""

import math
from collections import Counter, deque
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import AxisMap, KrcTelegram, SensorCodec, load_ethernet_xml
from deltaq_protocol.rsi.axes import DEG_PER_RAD, MM_PER_M
from deltaq_protocol.rsi.layout import MAX_IPOC, usual_telegram
from deltaq_protocol.rsi.sensor_codec import MAX_TELEGRAM_BYTES
from deltaq_services.containment import Part
from deltaq_services.robot_server.crash_brake.core import CrashPlan
from deltaq_services.robot_server.cycle_meter import CycleMeter
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.mode_probe import SESSIONS
from deltaq_services.robot_server.reply_guard import reply_fault
from deltaq_services.robot_server.session import (
    IPOC_WRAP,
    STILL,
    Answer,
    Belief,
    Plausibility,
    Session,
    TelegramKind,
)


def sensor_codec(cell: CellDescription, robot: str, ethernet_xml: Path) -> SensorCodec:
    """The PC's telegrams of a robot, from the file that its KRC has loaded."""
    description = cell.robots[robot]
    assert isinstance(description.driver, RsiDescription)  # asked only of robots that speak RSI
    return SensorCodec(
        load_ethernet_xml(ethernet_xml),
        AxisMap.of(description.joint_names, description.units, description.driver.krc),
        description.driver.inputs,
        description.driver.outputs,
        description.driver.stop,
    )


def crash_plan(cell: CellDescription, robot: str, ethernet_xml: Path) -> CrashPlan:
    """What has to be known to brake a robot whose Robot Server has died, from the file that its KRC has loaded."""
    description = cell.robots[robot]
    driver = description.driver
    assert isinstance(driver, RsiDescription)  # asked only of robots that speak RSI
    codec = sensor_codec(cell, robot, ethernet_xml)
    pattern, programmed = usual_telegram(load_ethernet_xml(ethernet_xml))
    template, places = codec.template
    return CrashPlan(
        pattern=pattern,
        elements=programmed,
        most_bytes=MAX_TELEGRAM_BYTES,
        template=template.decode(),
        places=places,
        commanded=tuple(codec.axes.commanded.tolist()),
        outputs=len(driver.outputs),
        most=tuple((description.max_velocity * cell.cycle_s).tolist()),
        cycle_s=cell.cycle_s,
        silence_s=cell.gate.krc_timeout_s,
        lag_cycles=math.ceil(cell.gate.servo_lag_s / cell.cycle_s),
        has_stop=driver.stop is not None,
    )


class RsiDriver(Part):
    """One RSI channel.

    Args:
        codec: telegrams of the robot.
        cell: the cell.
        robot: the robot's name.
        counters: gets the counts of rejected telegrams.

    Attributes:
        unmoved: answer to a telegram that `read` rejected: the present correction; None: do not answer.
        implausible: why the last telegram is not plausible; empty if it is.
        fault: why the guard refused the last setpoint; None if it did not.
        session: beliefs about the telegrams.
        meter: of the KRC's cycle; None: it ticks as the cell says.
        detail: faults, as text; empty if there are none.
    """

    def __init__(self, codec: SensorCodec, cell: CellDescription, robot: str, counters: Counter[str]) -> None:
        description = cell.robots[robot]
        driver = description.driver
        assert isinstance(driver, RsiDescription)  # asked only of robots that speak RSI
        self.unmoved: bytes | None = None
        self.implausible = ""
        self.fault: str | None = None
        self.detail = ""
        self._codec = codec
        self._counters = counters
        self._plausible = Plausibility.of(description, cell.cycle_s)
        self._near = description.tracking_tolerance
        self.session = Session(
            cell.cycle_s, cell.gate.krc_timeout_s, driver.ipoc_step, self._plausible, self._near
        )
        self.meter: CycleMeter | None = CycleMeter(cell.cycle_s, cell.gate.krc_timeout_s, driver.ipoc_step)
        self._most = (description.max_velocity * cell.cycle_s).tolist()
        self._widest = _widest(description.units, driver)
        self._origin: Array | None = None
        self._lower: list[float] = []
        self._upper: list[float] = []
        self._zero = np.zeros(codec.joints)
        self._sent: Array | None = None
        self._earlier: deque[tuple[Array, Array]] = deque(maxlen=SESSIONS)
        self._opened = False
        self._outputs: Mapping[str, bool] = {}

    def read(self, datagram: bytes, time_s: float) -> Measurement | None:
        """Read a telegram.

        Args:
            datagram: received from the KRC.
            time_s: when it came, on a monotonic clock.

        Returns:
            The measurement; None if the answer must be `unmoved` instead of a setpoint: the telegram is repeated or
            out of order, reports no joints (the first telegram of a KR C2), is not plausible, or may be of a session
            that is not confirmed yet.

        Raises:
            TelegramError: if it is no telegram of this robot.
        """
        self.unmoved, self.implausible = None, ""
        telegram = self._codec.decode(datagram)
        if telegram.ipoc > MAX_IPOC:
            self._counters["telegrams_implausible"] += 1
            self.implausible = f"IPOC is {telegram.ipoc}, and a KRC's has 32 bit: at most {MAX_IPOC}"
            return None
        if telegram.q is None:
            self._opens(telegram)
            return None
        place_fault = self._plausible.of_place(telegram.q.tolist())
        if place_fault is not None:
            self._implausible(telegram, place_fault)
            return None
        last = self.session.last
        kind, answer, why = self.session.judge(telegram, time_s)
        if kind is TelegramKind.NEXT and last is not None:
            self._opened = False
            return self._measured(telegram, last, time_s)
        if kind is TelegramKind.GARBLED:
            self._implausible(telegram, why)
        if kind is TelegramKind.CONFIRMED:
            return self._confirmed(telegram, time_s)
        if answer is Answer.UNMOVED:
            kept = self._kept(telegram)
            sent = self._zero if self._sent is None else self._sent
            if kept is not None and _equal(kept, sent):
                self.unmoved = self._codec.encode(telegram.ipoc, sent, self._outputs)
        return None

    def reply(self, q_cmd: Array, outputs: Mapping[str, bool], stop: bool = False) -> bytes:
        """The answer to the telegram read last, with the setpoint (n,) [rad or m].

        A correction that the guard refuses is not sent: the last one is repeated, and `fault` says why. If there is an
        error, nothing is as if it had been sent.
        """
        assert self._origin is not None  # there is no setpoint without a session
        assert self._sent is not None  # a session begins with the correction that the KRC has
        assert self.session.last is not None  # and with a telegram
        correction = q_cmd - self._origin
        fault = reply_fault(correction.tolist(), self._sent.tolist(), self._most, self._lower, self._upper)
        sent = correction if fault is None else self._sent
        reply = self._codec.encode(self.session.last.ipoc, sent, outputs, stop=stop)
        self.fault, self._sent, self._outputs = fault, sent, dict(outputs)
        return reply

    @property
    def q_sent(self) -> Array:
        """(n,) setpoint that the KRC was sent last [rad or m]."""
        assert self._origin is not None  # asked only after a reply
        assert self._sent is not None  # asked only after a reply
        return self._origin + self._sent

    @property
    def correction(self) -> tuple[float, ...]:
        """(n,) correction that was sent last [rad or m]."""
        assert self._sent is not None  # asked only after a reply
        return tuple(self._sent.tolist())

    @property
    def limits(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Least and greatest correction of the session, (n,) each [rad or m]."""
        return tuple(self._lower), tuple(self._upper)

    def _opens(self, telegram: KrcTelegram) -> None:
        """A KR C2 begins with a telegram that has nothing but its IPOC."""
        self._opened = True
        self.session.interrupted()
        sent = self._zero if self._sent is None else self._sent
        if _equal(sent, self._zero):
            self.unmoved = self._codec.encode(telegram.ipoc, sent, self._outputs)

    def _measured(self, telegram: KrcTelegram, last: KrcTelegram, time_s: float) -> Measurement:
        assert telegram.q is not None  # a session consists of telegrams with a position
        assert self.session.step is not None  # and has a step
        late = 0 if telegram.delay is None or last.delay is None else telegram.delay - last.delay
        if self.meter is not None:
            self.meter.tick((telegram.ipoc - last.ipoc) % IPOC_WRAP // self.session.step, time_s)
        return Measurement(
            telegram.ipoc, telegram.q, None, late > 0, telegram.inputs, False, *self._cycle_found
        )

    @property
    def _cycle_found(self) -> tuple[bool, str]:
        """Whether the KRC's cycle is known to be the cell's, and why it is not."""
        return (True, "") if self.meter is None else (self.meter.known, self.meter.fault)

    def _confirmed(self, telegram: KrcTelegram, time_s: float) -> Measurement | None:
        """Begin a session from the correction that the KRC has."""
        kept = self._kept(telegram)
        if kept is None:
            self.detail = (
                "a new session of the KRC stands neither where it was sent nor at its programmed position"
            )
            return None
        assert telegram.q is not None  # asked only of telegrams with a position
        self.session.believe(telegram, time_s)
        self._opened, self.detail = False, ""
        if self._origin is not None and self._sent is not None:
            self._earlier.append((self._origin, self._sent))
        self._sent = kept
        origin = telegram.q - kept if telegram.q_programmed is None else telegram.q_programmed
        self._begin_at(origin)
        assert self.session.step is not None  # the session has the step of the telegrams that it began with
        if self.meter is not None:
            self.meter.begin(self.session.step, time_s)
        return Measurement(
            telegram.ipoc,
            telegram.q,
            origin + kept,
            False,
            telegram.inputs,
            kept is not self._zero,
            *self._cycle_found,
        )

    def _begin_at(self, origin: Array) -> None:
        self._origin = origin
        self._lower = np.maximum(np.array(self._plausible.lower) - origin, -self._widest).tolist()
        self._upper = np.minimum(np.array(self._plausible.upper) - origin, self._widest).tolist()

    def _kept(self, telegram: KrcTelegram) -> Array | None:
        """(n,) the KRC's present correction, from the robot's position; None if it is ambiguous."""
        q, programmed, sent = telegram.q, telegram.q_programmed, self._sent
        assert q is not None  # asked only of telegrams with a position
        if programmed is None:
            anew = sent is None or self._opened or _equal(sent, self._zero)
            return self._zero if anew else None
        if sent is None:
            return self._zero if _equal(q, programmed) else q - programmed
        off_programmed = float(np.max(np.abs(q - programmed) / self._near))
        sessions = [*self._earlier] if self._origin is None else [*self._earlier, (self._origin, sent)]
        for origin, sent_there in reversed(sessions):
            if _equal(programmed, origin):
                off_sent = float(np.max(np.abs(q - programmed - sent_there) / self._near))
                if off_sent <= min(1.0, off_programmed):
                    return sent_there
                break
        return self._zero if off_programmed <= 1.0 else None

    def _implausible(self, telegram: KrcTelegram, why: str) -> None:
        """Count a telegram that is not plausible; within a session its answer is the last correction."""
        self._counters["telegrams_implausible"] += 1
        self.implausible = why
        if self.session.belief is Belief.BELIEVED and self._sent is not None:
            self.unmoved = self._codec.encode(telegram.ipoc, self._sent, self._outputs)


def _widest(units: tuple[str, ...], driver: RsiDescription) -> Array:
    """(n,) correction that the cell allows at most [rad or m]; infinite where it names none."""
    degrees, millimetres = driver.max_correction_deg, driver.max_correction_mm
    return np.array(
        [
            np.inf if most is None else most / per
            for most, per in (
                (degrees, DEG_PER_RAD) if unit == "rad" else (millimetres, MM_PER_M) for unit in units
            )
        ]
    )


def _equal(one: Array, other: Array) -> bool:
    return bool((np.abs(one - other) <= STILL).all())
