"""The core of the emulated controller: cycles and datagrams in, telegrams out; no clock, no sockets.

One cycle: `tick` begins it, judges the replies to the last telegram, moves the robot by one cycle and
returns the telegram to send; `receive` takes the datagrams that come until the next `tick`.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

from deltaq_cell.description import RobotDescription, RsiDescription
from deltaq_emulator.catalogue import Code, KrcMessage
from deltaq_emulator.corrections import CorrectionLimits, Corrections, Monitors
from deltaq_emulator.drives import Drives
from deltaq_emulator.faults import Forgery
from deltaq_emulator.recorder import Sample
from deltaq_emulator.replies import ReplyJudge
from deltaq_emulator.settings import (
    CorrectionMode,
    KrcSettings,
    LateBudget,
    OperatingMode,
    Profile,
    SettingsError,
)
from deltaq_emulator.states import TELEGRAMS_GO_OUT, KrcEvent, KrcState, NotNowError, after
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import AxisMap, EthernetConfig, KrcCodec, KrcReport
from deltaq_protocol.rsi.krc_codec import pose_from_matrix

TOOL_CHANGE_S = 0.3
"""Time that an emulated tool changer takes to lock or to open."""
START_CYCLES = 10
"""How long a program needs from its start to RSI_ON, at least."""
IPOC_RANGE = 2**32


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
        limits: of the corrections, axis by axis; those of the settings if not given.

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
        limits: CorrectionLimits | None = None,
    ) -> None:
        self.robot = robot
        self.cycle_s = cycle_s
        self.settings = settings or KrcSettings()
        self._profile = profile
        self._forward = forward
        axes = AxisMap.of(robot.joint_names, robot.units, profile.name)
        driver = robot.driver
        assert isinstance(driver, RsiDescription)  # a robot without RSI has no controller to emulate
        self._driver = driver
        self._codec = KrcCodec(
            config, axes, driver.inputs, driver.outputs, self.settings.precision, driver.stop
        )
        self._budget = LateBudget(
            self.settings.late_count or profile.late_count,
            self.settings.late_budget,
            self.settings.late_percent,
        )
        self._judge = ReplyJudge(
            self._codec, profile.reply_within * cycle_s, self._budget, self.settings.count_from
        )
        limits = limits or CorrectionLimits.of(axes, self.settings)
        self._corrections = Corrections(self._codec, limits)
        self._monitors = Monitors(robot, axes, self.settings, cycle_s, limits.monitor)
        within = (self._monitors.lower <= q_start) & (q_start <= self._monitors.upper)
        if not within.all():
            raise SettingsError(
                f"the robot cannot start at {q_start}: allowed is between {robot.lower} and {robot.upper} "
                "(rad or m)"
            )
        self._drives = Drives(robot, cycle_s, q_start, self._monitors.lower, self._monitors.upper)
        self._revolute = np.array([unit == "rad" for unit in robot.units])
        self._start = q_start.copy()
        self._tool = forward(q_start)
        self._tool_start = self._tool
        self.inputs: dict[str, bool] = dict.fromkeys(robot.inputs, False)
        """Digital inputs, as the operator or the emulated world sets them."""
        self.mode = self.settings.mode
        """Operating mode."""
        self.correction: CorrectionMode = self.settings.correction
        """The argument with which the program calls RSI_ON."""
        self.message: KrcMessage | None = None
        """The message on the pendant."""
        self.text = ""
        """What the PC last wrote on the pendant (EStr)."""
        self._state = KrcState.DRIVES_OFF
        self._cycle = 0
        self._sent = 0
        step = self.settings.ipoc_step or driver.ipoc_step or "ms"
        self._ipoc_step = round(cycle_s * 1000) if step == "ms" else step
        self._ipoc = (self.settings.ipoc_start - self._ipoc_step) % IPOC_RANGE
        self._starting: int | None = None
        self._frozen = 0
        self._opens, self._change_in = False, -1
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

    def tick(self, excused: bool = False) -> bytes | None:
        """Begin a cycle; returns the telegram to send, or None when RSI is off.

        Args:
            excused: the machine held up the controller itself during the last cycle: a missing reply does not
                count against the PC.
        """
        self._cycle += 1
        self._ipoc = (self._ipoc + self._ipoc_step) % IPOC_RANGE
        self._move()
        telegram = None
        if self._frozen > 0:
            self._frozen -= 1
            self._drives.stand()
        else:
            if self._state in TELEGRAMS_GO_OUT:
                self._close_cycle(excused)
            if self._state is not KrcState.RSI_RUNNING:
                self._drives.brake()
                self._go_on()
            if self._state in TELEGRAMS_GO_OUT:
                telegram = self._telegram()
        self._sample = self._make_sample()
        return telegram

    def receive(self, datagram: bytes, age_s: float = 0.0) -> None:
        """Process a datagram that arrived `age_s` after this cycle's telegram; a cycle may have any number."""
        self._judge.judge(datagram, age_s)

    def _move(self) -> None:
        tool_before = self._tool
        dq = self._drives.advance()
        self._tool = self._forward(self._drives.q)
        tool_m = float(np.linalg.norm(self._tool[:3, 3] - tool_before[:3, 3]))
        self._fail(self._monitors.of_motion(dq, tool_m, self.mode))

    def _close_cycle(self, excused: bool) -> None:
        if not self._judge.waiting:
            return
        reply = self._judge.close_cycle(excused)
        if reply is not None and reply.text:
            self.text = reply.text
        self._corrections.take(reply)
        self._change_tool()
        self._fail(self._budget.exceeded)
        if self._state is not KrcState.RSI_RUNNING:
            return
        if self._corrections.stop_rose:
            self._state = after(self._state, KrcEvent.END_MOTION)
            self.message = KrcMessage(Code.MOTION_ENDED, self._driver.stop or "")
            return
        setpoint = self._start + self._corrections.move()
        message = self._monitors.of_setpoint(setpoint, self._corrections.total)
        if message is None:
            self._drives.send_to(setpoint)
        else:
            self._fail(message)

    def _change_tool(self) -> None:
        """Let the input of a tool changer follow its output; what an operator sets in between stays."""
        changer = self.robot.tool_changer
        if changer is None:
            return
        if self._corrections.outputs[changer.release] is not self._opens:
            self._opens, self._change_in = not self._opens, round(TOOL_CHANGE_S / self.cycle_s)
        elif self._change_in > 0:
            self._change_in -= 1
        if self._change_in == 0:
            self.inputs[changer.locked], self._change_in = not self._opens, -1

    def _telegram(self) -> bytes:
        first = not self._judge.waiting
        self._judge.sent(self._ipoc)
        self._sent += 1
        if first and self._profile.ipoc_only_first:
            return self._codec.encode_ipoc_only(self._ipoc)
        return self._codec.encode(self._report())

    def _report(self) -> KrcReport:
        return KrcReport(
            self._ipoc,
            self._drives.q,
            self._start,
            pose_from_matrix(self._tool),
            pose_from_matrix(self._tool_start),
            self._judge.delay,
            self.inputs,
        )

    def _make_sample(self) -> Sample:
        counters = dict(self._judge.counts)
        counters |= {
            "clamped": self._corrections.clamped,
            "sent": self._sent,
            "delay": self._judge.delay,
            "late_counted": self._budget.counted,
        }
        message = None if self.message is None else str(self.message)
        return Sample(
            self._cycle, self._ipoc, self._drives.q, self._drives.setpoint, self._state, message, counters
        )

    # --- the program --------------------------------------------------------------------------------------

    def _begin_session(self) -> None:
        """RSI_ON, and RSI_MOVECORR after it."""
        self._state = after(self._state, KrcEvent.START)
        self._starting = None
        self._drives.stand()
        self._start = self._drives.setpoint.copy()
        self._tool_start = self._forward(self._start)
        self._judge.begin_session()
        self._monitors.begin_session(self._start)
        self._corrections.begin_session(self.correction)
        if self.mode is OperatingMode.T1:
            self.message = KrcMessage(Code.CONFIRM_MOTION)
        else:
            self.confirm()

    def _go_on(self) -> None:
        """The program's next step when the robot rests."""
        if self._starting is not None:
            self._starting = max(self._starting - 1, 0)
        if not self._drives.at_rest:
            return
        if self._state is KrcState.MOTION_ENDED:
            self._state = after(self._state, KrcEvent.END)
        elif self._starting == 0:
            self._begin_session()

    def _fail(self, message: KrcMessage | None) -> None:
        if message is not None and self._state in TELEGRAMS_GO_OUT:
            self._state = after(self._state, KrcEvent.FAULT)
            self.message = message

    # --- the operator's side ------------------------------------------------------------------------------

    def set_drives(self, on: bool) -> None:
        """Switch the drives on or off."""
        self._operate(KrcEvent.DRIVES_ON if on else KrcEvent.DRIVES_OFF, None if on else Code.DRIVES_OFF)

    def set_mode(self, mode: OperatingMode) -> None:
        """Turn the key: a running program stops."""
        running = self._state in TELEGRAMS_GO_OUT
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

    def confirm(self) -> None:
        """Confirm that corrections may move the robot, as T1 demands."""
        self._state = after(self._state, KrcEvent.CONFIRM)
        self.message = None

    def restart(self, correction: CorrectionMode | None = None) -> None:
        """Start the program again, from where the robot comes to rest; RSI runs some cycles later.

        Args:
            correction: start the program that calls RSI_ON with this; none: the one that ran last.

        Raises:
            NotNowError: if a message has to be acknowledged first or the drives are off.
        """
        if self._state in TELEGRAMS_GO_OUT:
            self.stop()
        after(self._state, KrcEvent.START)
        self.correction = correction or self.correction
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
        """Fall silent for a number of cycles, then continue as before."""
        self._frozen = cycles

    def shift_ipoc(self, by: int) -> None:
        """Let the time stamp jump, forward or back."""
        self._ipoc = (self._ipoc + by) % IPOC_RANGE

    def turn(self, correction: CorrectionMode) -> None:
        """Take corrections otherwise from now on, within a session: no program does that."""
        self.correction = correction
        self._corrections.turn(correction)

    def forged(self, forgery: Forgery) -> bytes:
        """A forged telegram, made from this cycle's telegram."""
        report = self._report()
        shift = math.radians(forgery.offset_deg)
        return self._codec.encode(
            report._replace(
                ipoc=(report.ipoc + forgery.ipoc_shift) % IPOC_RANGE,
                q=report.q + shift * self._revolute,
                q_programmed=report.q_programmed + forgery.programmed_too * shift * self._revolute,
            )
        )
