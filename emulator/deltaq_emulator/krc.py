"""The core of the emulated controller: cycles and datagrams in, telegrams out; no clock, no sockets.

One cycle: `tick` begins it, judges what came in reply to the last telegram, moves the robot by one cycle and
returns the telegram to send; `receive` takes whatever comes until the next `tick`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from deltaq_cell.description import Array, RobotDescription, RsiDriver
from deltaq_emulator.catalogue import Code, KrcMessage
from deltaq_emulator.corrections import Corrections
from deltaq_emulator.monitors import Monitors
from deltaq_emulator.profiles import Profile
from deltaq_emulator.replies import ReplyJudge
from deltaq_emulator.servo import Servo
from deltaq_emulator.settings import KrcSettings, Mode, SettingsError
from deltaq_emulator.states import KrcEvent, KrcState, NotNowError, after
from deltaq_protocol.rsi import AxisMap, EthernetConfig, KrcCodec, KrcReport
from deltaq_protocol.rsi.pose import pose_from_matrix

START_CYCLES = 10
"""How long a program needs from its start to RSI_ON, at least."""
REST_TOLERANCE = 1e-5
"""A robot nearer to its setpoint than this has come to rest [rad or m]."""


@dataclass(frozen=True)
class Sample:
    """One cycle of the emulated robot, for recorders and judges.

    Attributes:
        cycle: cycles since the controller was switched on.
        q: (n,) actual joints at the beginning of the cycle [rad or m].
        q_setpoint: (n,) where the drives are sent during the cycle, corrections included [rad or m].
        message: what is on the pendant, if anything.
        counters: datagrams and cycles by class, see `deltaq_emulator.replies.Reply`, and `clamped`, `sent`,
            `delay` (the telegram's element), `late_counted` (against the budget).
    """

    cycle: int
    ipoc: int
    q: Array
    q_setpoint: Array
    state: KrcState
    message: str | None
    counters: Mapping[str, int]


class Krc:
    """An emulated controller with its robot.

    Args:
        robot: limits, lag of the drives, names of digital inputs and outputs.
        cycle_s: its sensor cycle [s].
        config: the `*_ethernet.xml` that it loads.
        profile: which generation it is.
        q_start: (n,) where the robot stands [rad or m].
        forward: (n,) joints to the (4, 4) pose of the tool in the robot's base.
        settings: limits, budgets, operating mode.
        start: switch the drives on and start RSI at once.

    Raises:
        EthernetConfigError: if the configuration does not fit the robot.
        SettingsError: if the start is outside the joint limits.
    """

    def __init__(
        self,
        robot: RobotDescription,
        cycle_s: float,
        config: EthernetConfig,
        profile: Profile,
        q_start: Array,
        forward: Callable[[Array], Array],
        settings: KrcSettings | None = None,
        start: bool = True,
    ) -> None:
        self.robot = robot
        self.cycle_s = cycle_s
        self.settings = settings or KrcSettings()
        self._profile = profile
        self._forward = forward
        self._axes = AxisMap.of(robot.joint_names, robot.units, profile.name)
        driver = robot.driver
        assert isinstance(driver, RsiDriver)  # a robot without RSI has no controller to emulate
        self._codec = KrcCodec(config, self._axes, driver.inputs, driver.outputs, self.settings.precision)
        self._judge = ReplyJudge(
            self._codec,
            profile.reply_within * cycle_s,
            self.settings.late_budget,
            self.settings.late_count,
            self.settings.count_from,
        )
        self._corrections = Corrections(self._codec, self._axes, self.settings)
        self._monitors = Monitors(robot, self._axes, self.settings, cycle_s)
        within = (self._monitors.lower <= q_start) & (q_start <= self._monitors.upper)
        if not within.all():
            raise SettingsError(
                f"the robot cannot start at {q_start}: allowed is between {robot.lower} and {robot.upper} "
                "(rad or m)"
            )
        self._servo = Servo(q_start, robot.servo_lag, cycle_s)
        self._setpoint = q_start.copy()
        self._setpoint_step = np.zeros_like(q_start)
        self._start = q_start.copy()
        self._tool = forward(q_start)
        self._tool_start = self._tool
        self.inputs: dict[str, bool] = dict.fromkeys(robot.inputs, False)
        """Digital inputs, as the operator or the emulated world sets them."""
        self.mode = self.settings.mode
        """Operating mode."""
        self.message: KrcMessage | None = None
        """What is on the pendant."""
        self.text = ""
        """What the PC last wrote on the pendant (EStr)."""
        self._state = KrcState.DRIVES_OFF
        self._cycle = 0
        self._sent = 0
        self._step_ms = round(cycle_s * 1000)
        self._ipoc = (self.settings.ipoc_start - self._step_ms) % 2**32
        self._starting: int | None = None
        self._frozen = 0
        if start:
            self.set_drives(True)
            self._begin_session()
        self._sample = self._make_sample()

    @property
    def sample(self) -> Sample:
        """The cycle that the last `tick` began."""
        return self._sample

    @property
    def state(self) -> KrcState:
        """State of the controller."""
        return self._state

    @property
    def outputs(self) -> Mapping[str, bool]:
        """Digital outputs as the sensor telegrams set them."""
        return dict(self._corrections.outputs)

    # --- cycles -------------------------------------------------------------------------------------------

    def tick(self) -> bytes | None:
        """Begin a cycle; returns the telegram to send, or None when RSI is not running."""
        self._cycle += 1
        self._ipoc = (self._ipoc + self._step_ms) % 2**32
        self._move()
        telegram = None
        if self._frozen > 0:
            self._frozen -= 1
            self._setpoint_step = np.zeros_like(self._setpoint)
        else:
            if self._state is KrcState.RSI_RUNNING:
                self._close_cycle()
            if self._state is not KrcState.RSI_RUNNING:
                self._come_to_rest()
                self._start_if_asked()
            if self._state is KrcState.RSI_RUNNING:
                telegram = self._telegram()
        self._sample = self._make_sample()
        return telegram

    def receive(self, datagram: bytes, age_s: float = 0.0) -> None:
        """Take a datagram that came `age_s` after this cycle's telegram was sent; any number in a cycle."""
        self._judge.judge(datagram, age_s)

    def _move(self) -> None:
        before, tool_before = self._servo.q, self._tool
        self._servo.advance(self._setpoint)
        self._tool = self._forward(self._servo.q)
        tool_m = float(np.linalg.norm(self._tool[:3, 3] - tool_before[:3, 3]))
        self._fail(self._monitors.of_motion(self._servo.q - before, tool_m, self.mode))

    def _close_cycle(self) -> None:
        if not self._judge.waiting:
            return
        reply = self._judge.close_cycle()
        if reply is not None and reply.text:
            self.text = reply.text
        setpoint = self._start + self._corrections.apply(reply)
        message = self._monitors.of_setpoint(setpoint, self._corrections.total)
        if self._judge.over_budget:
            message = KrcMessage(Code.LATE_PACKETS, "", self._judge.late_counted, self.settings.late_budget)
        if message is None:
            self._setpoint_step = setpoint - self._setpoint
            self._setpoint = setpoint
        else:
            self._fail(message)

    def _telegram(self) -> bytes:
        first = not self._judge.waiting
        self._judge.sent(self._ipoc)
        self._sent += 1
        if first and self._profile.ipoc_only_first:
            return self._codec.encode_ipoc_only(self._ipoc)
        return self._codec.encode(
            KrcReport(
                self._ipoc,
                self._servo.q,
                self._start,
                pose_from_matrix(self._tool),
                pose_from_matrix(self._tool_start),
                self._judge.delay,
                self.inputs,
            )
        )

    def _make_sample(self) -> Sample:
        counters = dict(self._judge.counts)
        counters |= {
            "clamped": self._corrections.clamped,
            "sent": self._sent,
            "delay": self._judge.delay,
            "late_counted": self._judge.late_counted,
        }
        message = None if self.message is None else str(self.message)
        return Sample(self._cycle, self._ipoc, self._servo.q, self._setpoint, self._state, message, counters)

    # --- starting and stopping ----------------------------------------------------------------------------

    def _begin_session(self) -> None:
        self._state = after(self._state, KrcEvent.START)
        self._starting = None
        self.message = None
        self._start = self._setpoint.copy()
        self._setpoint_step = np.zeros_like(self._start)
        self._tool_start = self._forward(self._start)
        self._judge.begin_session()
        self._monitors.begin_session(self._start)
        self._corrections.reset()

    def _start_if_asked(self) -> None:
        if self._starting is None:
            return
        self._starting = max(self._starting - 1, 0)
        at_rest = (np.abs(self._servo.q - self._setpoint) < REST_TOLERANCE).all()
        if self._starting == 0 and at_rest and not self._setpoint_step.any():
            self._begin_session()

    def _come_to_rest(self) -> None:
        """Brake each axis at its own limit, as the drives do when RSI is gone."""
        if not self._setpoint_step.any():
            return
        brake = self.robot.max_acceleration * self.cycle_s**2
        speed = np.maximum(np.abs(self._setpoint_step) - brake, 0.0)
        setpoint = self._setpoint + np.sign(self._setpoint_step) * speed
        setpoint = np.clip(setpoint, self._monitors.lower, self._monitors.upper)
        self._setpoint_step = setpoint - self._setpoint
        self._setpoint = setpoint

    def _fail(self, message: KrcMessage | None) -> None:
        if message is not None and self._state is KrcState.RSI_RUNNING:
            self._state = after(self._state, KrcEvent.FAULT)
            self.message = message

    # --- the operator's side ------------------------------------------------------------------------------

    def set_drives(self, on: bool) -> None:
        """Switch the drives on or off."""
        self._operate(KrcEvent.DRIVES_ON if on else KrcEvent.DRIVES_OFF, None if on else Code.DRIVES_OFF)

    def set_mode(self, mode: Mode) -> None:
        """Turn the key: a running program stops."""
        running = self._state is KrcState.RSI_RUNNING
        self._operate(KrcEvent.CHANGE_MODE, None)
        self.mode = mode
        if running:
            self.message = KrcMessage(Code.MODE_CHANGED, mode)

    def stop(self) -> None:
        """Stop the program."""
        self._operate(KrcEvent.STOP, Code.OPERATOR_STOP)

    def acknowledge(self) -> None:
        """Acknowledge the message of a fault."""
        self._operate(KrcEvent.ACKNOWLEDGE, None)
        self.message = None

    def restart(self) -> None:
        """Start the program again, from where the robot comes to rest; RSI runs some cycles later.

        Raises:
            NotNowError: if a message has to be acknowledged first or the drives are off.
        """
        if self._state is KrcState.RSI_RUNNING:
            self.stop()
        after(self._state, KrcEvent.START)
        self._starting = START_CYCLES

    def _operate(self, event: KrcEvent, code: Code | None) -> None:
        self._state = after(self._state, event)
        self._starting = None
        if code is not None:
            self.message = KrcMessage(code)

    def set_input(self, name: str, value: bool) -> None:
        """Set a digital input.

        Raises:
            NotNowError: if the robot has none of that name.
        """
        if name not in self.inputs:
            raise NotNowError(f"no digital input {name!r}; this robot has {', '.join(self.inputs) or 'none'}")
        self.inputs[name] = value

    # --- faults -------------------------------------------------------------------------------------------

    def freeze(self, cycles: int) -> None:
        """Fall silent for a number of cycles, then go on as if nothing had been."""
        self._frozen = cycles

    def shift_ipoc(self, milliseconds: int) -> None:
        """Let the time stamp jump, forward or back."""
        self._ipoc = (self._ipoc + milliseconds) % 2**32
