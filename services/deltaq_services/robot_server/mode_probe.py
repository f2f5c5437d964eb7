"""Finds out, before a session's first motion, how the KRC takes corrections, and how far its drives lag.

A KRC takes them as offsets, or adds them up. Trials (`deltaq_services.robot_server.probe_trial`) are repeated until
one gives a result. The additions of a trial sum up to zero, so they are undone in either mode, and no joint gets
further than `PROBE_RAD` or `PROBE_M`.
"""

import math
from collections import deque

import numpy as np

from deltaq_cell.description import RobotDescription, RsiDescription
from deltaq_cell.drive_lag import LONGEST_S, AxisLag, lag_fault
from deltaq_protocol.arrays import Array
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.containment import Part
from deltaq_services.robot_server.probe_trial import (
    Mode,
    Trial,
    joint_lags,
    joint_modes,
    pulse_sums,
    triangle,
)

SESSIONS = 64
"""Sessions that are remembered: a KRC that comes back after another was believed has its own correction still."""

_Pair = tuple[tuple[float, ...], tuple[float, ...]]
_SAME = 1e-9
"""Differences that rounding makes of one setpoint [rad or m]."""


class PulsesCutShort(Part):
    """Interrupted pulses of a probe, which the next setpoint in their KRC session undoes.

    Otherwise each would shift the start of the next session, and a sender that starts sessions could move the robot
    without any admission.
    """

    def __init__(self) -> None:
        self._last: _Pair | None = None
        self._cut: deque[_Pair] = deque(maxlen=SESSIONS)

    def sent(self, q_cmd: Array, setpoint: Array) -> None:
        """Note a reply: `q_cmd` (n,) was sent, the sum of the `setpoint` (n,) and the probe's pulse [rad or m]."""
        self._last = tuple(q_cmd.tolist()), tuple(setpoint.tolist())

    def cut_short(self) -> None:
        """Another session begins."""
        if self._last is not None:
            self._cut.append(self._last)
        self._last = None

    def undone(self, q_start: Array) -> Array:
        """The setpoint (n,) of a session that continues from `q_start` (n,), without its interrupted pulse."""
        for q_cmd, setpoint in reversed(self._cut):
            if (np.abs(np.array(q_cmd) - q_start) <= _SAME).all():
                return np.array(setpoint)
        return q_start


ADRIFT = 3.0
"""A joint this many times a pulse's sum away from where the session began is moving by itself."""

_ADRIFT_CYCLES = 3
"""Cycles in a row in which it has to be there: a single telegram may be a forged one."""

_PAUSE_WINDOWS = 2
"""Windows to wait after a trial without a result."""

_IPOC_WRAP = 2**32

_REMEDY = "nothing is driven in this session: let the program call RSI_ON(#ABSOLUTE), and start it again"


class KinematicMode(Part):
    """The mode of a kinematic robot: it always reaches its setpoint, so no probe is needed."""

    mode = Mode.ABSOLUTE
    known = idle = True
    refused = bars = False
    reason = ReasonCode.RSI_MODE
    lags: tuple[AxisLag | None, ...] = ()
    detail = ""

    def cycle(self, q: Array, ipoc: int, missed_last: bool) -> None:
        """Does nothing: there is nothing to measure."""

    def added_to(self, setpoint: Array) -> Array:
        """The setpoint, unchanged."""
        return setpoint

    def lags_too_long(self, fault: str) -> None:
        """Does nothing: a kinematic robot has no lag."""

    def end(self) -> None:
        """Does nothing: there is no pulse to undo."""


class ModeProbe(Part):
    """The probe of one session.

    Args:
        robot: its joints.
        cycle_s: sample time.
        lag_cycles: cycles within which the gate presumes the drives to be where they were sent.
        q: (n,) measured configuration at the begin of the session, at rest [rad or m].

    Attributes:
        mode: the result; constant once it is known.
        unseen: names of the joints that did not follow the last trial; empty before the first has ended.
        lags: of each joint; None without a result, empty before the mode is known.
        trial_cycles: telegrams of a trial; with the last of them it is judged.
    """

    def __init__(self, robot: RobotDescription, cycle_s: float, lag_cycles: int, q: Array) -> None:
        self.mode = Mode.UNKNOWN
        self.unseen: tuple[str, ...] = ()
        self._joints = robot.joint_names
        self._size = pulse_sums(robot)
        self._cycle_s, self._presumed_s = cycle_s, lag_cycles * cycle_s
        pulse = triangle(self._size, robot.max_acceleration * cycle_s**2)
        self._trial = Trial.of(len(pulse), max(lag_cycles, math.ceil(LONGEST_S / cycle_s)), cycle_s)
        self._presumed_window = Trial.of(len(pulse), lag_cycles, cycle_s).window
        half = np.concatenate([pulse, np.zeros(self._trial.window - len(pulse))])
        self._course = np.concatenate([np.zeros(self._trial.rest), half, -half, [0.0]])
        self.trial_cycles = len(self._course)
        self._offset = np.zeros_like(q)
        self._q_start = q
        self._adrift_cycles = 0
        self._ended = False
        self._ipoc: int | None = None
        self._ipoc_step = _IPOC_WRAP
        self._cycle = 0
        self._samples: list[tuple[float, ...]] = []
        self._cycles: list[int] = []
        self._void = False
        self.lags: tuple[AxisLag | None, ...] = ()
        self._lagging = ""

    @property
    def known(self) -> bool:
        """Whether corrections are offsets and the drives lag as the gate presumes, so that the robot may be driven."""
        return self.mode is Mode.ABSOLUTE and not self._lagging

    @property
    def refused(self) -> bool:
        """Whether no robot is driven in this session: for its mode, or for its lag."""
        return self.mode in (Mode.RELATIVE, Mode.ADRIFT) or bool(self._lagging)

    @property
    def reason(self) -> ReasonCode:
        """Why the robot must not be driven, if it must not."""
        return ReasonCode.DRIVE_LAG if self._lagging else ReasonCode.RSI_MODE

    @property
    def bars(self) -> bool:
        """Whether the robot must not be driven now: it is refused, or its mode did not show when it was probed."""
        return self.refused or (not self.known and bool(self.unseen))

    @property
    def idle(self) -> bool:
        """Whether nothing is added, and nothing that was added is still to be undone."""
        return self.mode is not Mode.UNKNOWN or self._cycle <= self._trial.rest

    @property
    def detail(self) -> str:
        """The fault and its remedy, as text; empty if there is none."""
        if self.mode is Mode.ABSOLUTE:
            return self._lagging
        if self.mode is Mode.RELATIVE:
            return f"the KRC adds corrections up, as RSI_ON(#RELATIVE) does; {_REMEDY}"
        if self.mode is Mode.ADRIFT:
            return (
                f"the robot moves although its correction is constant, as with RSI_ON(#RELATIVE); {_REMEDY}"
            )
        if self.unseen:
            return (
                f"{', '.join(self.unseen)} did not follow the mode probe, which continues: are "
                "the drives on, is RSI_MOVECORR confirmed, does the KRC send four decimals, do the drives lag less "
                f"than {LONGEST_S * 1e3:.0f} ms?"
            )
        return "probes the mode of corrections"

    def cycle(self, q: Array, ipoc: int, missed_last: bool) -> None:
        """One telegram of the session.

        Args:
            q: (n,) measured [rad or m].
            ipoc: the KRC's stamp.
            missed_last: the last reply did not reach the KRC.
        """
        passed = self._cycles_passed(ipoc)
        lost = passed > 1 or missed_last
        if self.mode is not Mode.UNKNOWN:
            return
        if self._is_adrift(q):
            self.mode = Mode.ADRIFT
            return
        if self._ended and self.idle:
            return
        if self._cycle >= 0:
            # the KRC replaced late values by the value before, or by zero
            self._void |= lost and bool(self._course[max(self._cycle - 2, 0) : self._cycle].any())
            self._samples.append(tuple(q.tolist()))
            self._cycles.append(self._cycles[-1] + max(passed, 1) if self._cycles else 0)
            self._offset = self._course[self._cycle] * self._size
        self._cycle += 1
        if self._cycle == self.trial_cycles:
            self._judge()

    def added_to(self, setpoint: Array) -> Array:
        """What to send in this cycle instead of a setpoint (n,) [rad or m]."""
        return setpoint + self._offset if self.mode is Mode.UNKNOWN else setpoint

    def lags_too_long(self, fault: str) -> None:
        """The drives lagged more than the gate presumes while they moved: no robot is driven on in this session."""
        self._lagging = self._lagging or fault

    def end(self) -> None:
        """Undo the pulse that was added, and add no further one."""
        self._ended = True

    def _is_adrift(self, q: Array) -> bool:
        away = bool((np.abs(q - self._q_start) > ADRIFT * self._size).any())
        self._adrift_cycles = self._adrift_cycles + 1 if away else 0
        return self._adrift_cycles >= _ADRIFT_CYCLES

    def _cycles_passed(self, ipoc: int) -> int:
        """Cycles since the last telegram; more than one if some were lost."""
        passed = 0 if self._ipoc is None else (ipoc - self._ipoc) % _IPOC_WRAP
        self._ipoc = ipoc
        self._ipoc_step = min(self._ipoc_step, passed or _IPOC_WRAP)
        return math.ceil(passed / self._ipoc_step)

    def _judge(self) -> None:
        if self._void:
            self._cycle = 0
        else:
            samples = np.array(self._samples) / self._size
            seen = joint_modes(samples, self._trial, self._presumed_window)
            if Mode.UNKNOWN in seen:
                seen = joint_modes(samples, self._trial, self._trial.window)
            unknown = [mode is Mode.UNKNOWN for mode in seen]
            self.unseen = tuple(name for name, bad in zip(self._joints, unknown, strict=True) if bad)
            if Mode.RELATIVE in seen:
                self.mode = Mode.RELATIVE
            elif not self.unseen:
                self._measure_lags(samples)
            self._cycle = -_PAUSE_WINDOWS * self._trial.window
        self._samples, self._cycles, self._void = [], [], False

    def _measure_lags(self, samples: Array) -> None:
        cycles = np.array(self._cycles)
        lags = joint_lags(samples, cycles, self._trial, self._cycle_s)
        named = tuple(zip(self._joints, lags, strict=True))
        self.unseen = tuple(name for name, lag in named if lag and math.isinf(lag.least_s))
        if self.unseen:
            return
        self.mode, self.lags = Mode.ABSOLUTE, tuple(lags)
        beyond_s = [
            max(lag.least_s, min(lag.settled_s, LONGEST_S)) if lag and lag.least_s > self._presumed_s else 0.0
            for lag in lags
        ]
        self._lagging = lag_fault(self._joints, beyond_s, self._presumed_s, self._cycle_s)


def mode_of_session(
    robot: RobotDescription, cycle_s: float, lag_cycles: int, q: Array
) -> ModeProbe | KinematicMode:
    """What finds out the mode of a session that begins with the robot at `q`, see `ModeProbe`."""
    if isinstance(robot.driver, RsiDescription):
        return ModeProbe(robot, cycle_s, lag_cycles, q)
    return KinematicMode()
