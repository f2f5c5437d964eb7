"""The Robot Server's decisions: the setpoint of each cycle, and the robot's phase.

Pure: no clock, no socket. One call of `cycle` is one telegram of the KRC. It takes what has arrived from the
gate by then and returns at once the setpoint to send: the admitted increment, or the next step of the
brake that was verified with the last one. Before a robot on RSI becomes ready in a session, a probe below the size
of an increment finds out what its corrections do.
"""

from __future__ import annotations

import math
import signal
from collections import Counter
from dataclasses import replace
from functools import partial
from types import FrameType

import numpy as np

from deltaq_cell.description import CellDescription
from deltaq_cell.identity import content_identity
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, ServerState, Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.containment import Containment, Part
from deltaq_services.outputs import ToRobot
from deltaq_services.phases import MAY_MOVE, Event, next_phase
from deltaq_services.robot_server.guards import AdmissionsDue, Bounds, Refusal, refusal
from deltaq_services.robot_server.lag_watch import LagWatch
from deltaq_services.robot_server.measurement import Measurement, Settling
from deltaq_services.robot_server.mode_probe import KinematicMode, ModeProbe, PulsesCutShort, mode_of_session
from deltaq_services.robot_server.probe_trial import Mode

_TAKEN = (Admission, Supervision, Measurement)


class RobotServer(Part):
    """The state of one robot's server, advanced by one telegram at a time.

    Args:
        cell: the cell.
        robot: the robot's name.
        process: the instance id of this process.

    Attributes:
        outputs: digital outputs to be set, by name.
        motion_stop: the KRC has to end the motion itself, since this robot moves on although its setpoint rests.
        counters: events by name.
        guarded: whether a process is ready to brake the robot should this one die; the robot is held if not.
    """

    def __init__(self, cell: CellDescription, robot: str, process: int) -> None:
        self.robot = robot
        self.process = process
        self._identity = str(content_identity(cell))
        self.outputs: dict[str, bool] = dict.fromkeys(cell.robots[robot].outputs, False)
        self.motion_stop = False
        self._tool: str | None = None
        self.guarded = True
        self.counters: Counter[str] = Counter()
        self._bounds = Bounds.of(cell.robots[robot], cell.cycle_s)
        lag_cycles = math.ceil(cell.gate.servo_lag_s / cell.cycle_s)
        self._settling = Settling(cell.robots[robot].tracking_tolerance, lag_cycles)
        self._new_mode = partial(mode_of_session, cell.robots[robot], cell.cycle_s, lag_cycles)
        self._mode: ModeProbe | KinematicMode = KinematicMode()
        presumed_s = lag_cycles * cell.cycle_s
        self._new_lag_watch = partial(LagWatch, cell.robots[robot], cell.cycle_s, presumed_s)
        self._lag: LagWatch | None = None
        self._unwatched: tuple[Measurement, Array] | None = None
        self._pulses = PulsesCutShort()
        self._gate_timeout_cycles = math.ceil(cell.gate.gate_timeout_s / cell.cycle_s)
        self._krc_timeout_cycles = math.ceil(cell.gate.krc_timeout_s / cell.cycle_s)
        self._cycles_without_gate = 0
        self._cycles_missed = 0
        self._motion = SetpointMotion.at_rest(np.zeros(0))
        self._q_reset: Array | None = None
        self._epoch = 0
        self._resets = 0
        self._phase = Phase.OFFLINE
        self._reason: ReasonCode | None = None
        self._cycle = 0
        self._state: ServerState | None = None
        self._told: tuple[Measurement, float] | None = None
        self._admissions = AdmissionsDue(cell.gate.lookahead_cycles)
        self._supervision: Supervision | None = None
        self.containment = Containment()

    @property
    def state(self) -> ServerState | None:
        """The state to publish after each cycle; None before the first. It is made when asked for: after the reply."""
        self._watch_lag()
        if self._state is None and self._told is not None:
            self._state = self._publishable(*self._told)
        return self._state

    @property
    def motion(self) -> SetpointMotion:
        """The last sent setpoint, and the brake that follows it."""
        return self._motion

    @property
    def waiting(self) -> tuple[Admission, ...]:
        """Admissions that are due in a later cycle."""
        return self._admissions.kept

    @property
    def at_rest(self) -> bool:
        """Whether the brake has ended, no probe is to be undone, and the drives have had the time to catch up."""
        return self._settling.at_rest and self._mode.idle

    @property
    def detail(self) -> str:
        """The fault of the session's cycle or mode, as text; empty if there is none."""
        return (self._told is not None and self._told[0].cycle_fault) or self._mode.detail

    def cycle(
        self,
        measured: Measurement,
        time_s: float,
        admission: Admission | None = None,
        supervision: Supervision | None = None,
    ) -> Array:
        """Answer one telegram.

        Args:
            measured: the values that the KRC reported.
            time_s: time of arrival, for the published state only.
            admission: an admission that has come since the last cycle, if any; `take` takes further ones.
            supervision: the newest heartbeat of the gate since the last cycle, if any.

        Returns:
            (n,) setpoint to send now [rad or m].
        """
        if measured.q_start is not None:
            self._begin_session(measured.q, measured.q_start, measured.resumes)
        if admission is not None:
            self._keep(admission)
        follows = self.state
        self._cycle += 1
        self._watch(measured.q)
        self._probe(measured)
        if not self.guarded:
            self._stop(ReasonCode.CRASH_BRAKE_LOST)
        self._supervise(supervision, measured)
        if measured.missed_last:
            # the KRC still stands at the setpoint before: send the missed one again instead of a double step
            self._cycles_missed += 1
            self.counters["reply_missed"] += 1
            if self._cycles_missed > self._krc_timeout_cycles:
                self._stop(ReasonCode.KRC_LOST)
        else:
            self._cycles_missed = 0
            self._advance(follows)
        self._settling = self._settling.sent(bool(self._motion.dq.any()))
        self._told, self._state = (measured, time_s), None
        q_cmd = self._mode.added_to(self._held_at)
        if not self._mode.known:
            self._pulses.sent(q_cmd, self._held_at)
        self._unwatched = measured, q_cmd
        return q_cmd

    def take(self, message: Admission | Supervision | Measurement, time_s: float) -> list[ToRobot]:
        """Take a message: an admission waits for its cycle, the newest heartbeat counts, a measurement is a cycle.

        A message that causes an unexpected error is refused, and the robot is held. A cycle that fails continues the
        brake. If that fails, too, the error is raised: another process brakes the robot when this one has ended.

        Args:
            message: of the gate, or of the robot's driver.
            time_s: when it came, for the published state only.

        Returns:
            The setpoint and outputs to send to the robot; `state` is computed afterwards, when it is read.

        Raises:
            TypeError: for a message of a type that is not sent here.
        """
        if not isinstance(message, _TAKEN):
            raise TypeError(
                f"a Robot Server takes admissions, heartbeats and measurements, got a {type(message).__name__}"
            )
        if not isinstance(message, Measurement):
            try:
                self._hear(
                    message
                )  # the last that it does is to keep the message: there is nothing to put back
            except Exception as error:
                self.failed(error)
            return []
        self.containment.remember(self._parts())
        try:
            return self._take(message, time_s)
        except Exception as error:
            self.containment.put_back()
            self.failed(error)
        return self._take(message, time_s)

    def failed(self, error: Exception) -> None:
        """Hold the robot after an unexpected error, and drop all admissions."""
        self.containment.note(error)
        self.counters["internal_errors"] += 1
        self._stop(ReasonCode.INTERNAL_ERROR)
        self._admissions.forget()
        self._supervision = self._state = None

    def _parts(self) -> tuple[object, ...]:
        """The objects that change."""
        lag = () if self._lag is None else (self._lag,)
        return self, self._mode, self._pulses, self._admissions, *lag

    def _hear(self, message: Admission | Supervision) -> None:
        if isinstance(message, Admission):
            self._keep(message)
        else:
            self._supervision = message

    def _take(self, measured: Measurement, time_s: float) -> list[ToRobot]:
        supervision, self._supervision = self._supervision, None
        q_cmd = self.cycle(measured, time_s, supervision=supervision)
        return [ToRobot(q_cmd, self.outputs, self.motion_stop)]

    def krc_silent(self, time_s: float) -> None:
        """Hold the robot, because the KRC was silent for longer than its timeout."""
        self.counters["krc_silent"] += 1
        if self._told is None:
            return
        self._stop(ReasonCode.KRC_LOST)
        if self._phase is Phase.HELD:
            self._reason = ReasonCode.KRC_LOST  # of several causes this one stands
        # the KRC has held its last correction by now: what is left of a brake would set the robot in motion
        self._rest()
        self._told, self._state = (self._told[0], time_s), None

    def reply_refused(self, q_sent: Array) -> None:
        """Hold the robot at the setpoint that was sent in place of the decided one.

        Args:
            q_sent: (n,) setpoint that the KRC has [rad or m].
        """
        self.counters["replies_refused"] += 1
        self._stop(ReasonCode.REPLY_REFUSED)
        if self._mode.mode is Mode.ABSOLUTE:
            self._q_reset = q_sent.copy()
        else:  # the difference is the probe's, which continues and is undone
            self._pulses.sent(q_sent, self._held_at)
        self._rest()
        self._state = None

    def end(self) -> None:
        """Come to rest along the brake, and stay there: a signal ends this process."""
        self._stop(ReasonCode.SERVER_ENDED)
        self._mode.end()

    @property
    def _held_at(self) -> Array:
        """(n,) setpoint that the KRC has: its own in a new session, until a reset adopts it."""
        return self._motion.q_cmd if self._q_reset is None else self._q_reset

    def _begin_session(self, q: Array, q_start: Array, resumes: bool) -> None:
        self._pulses.cut_short()
        if resumes:
            q_start = self._pulses.undone(q_start)
        if self._cycle > 0:
            self.counters["session_restarted"] += 1
            self._stop(ReasonCode.KRC_LOST)
            if self._reason in (ReasonCode.RSI_MODE, ReasonCode.DRIVE_LAG, ReasonCode.CYCLE_MISMATCH):
                self._reason = ReasonCode.KRC_LOST  # that was found out in the session before
        if self._phase is Phase.OFFLINE:
            self._motion = replace(self._motion, q_cmd=q_start.copy())
        else:
            self._q_reset = q_start.copy()
        # a session begins with a robot that stands: the motion has ended, and a stop would end the session, too
        self.motion_stop = False
        self._settling = self._settling.sent(moves=True)
        self._rest()
        self._mode, self._lag, self._unwatched = self._new_mode(q), None, None

    def _watch(self, q: Array) -> None:
        """Hold a robot that is off its setpoint after settling, and end its motion if it still moves."""
        self._settling = self._settling.measured(q)
        if not self._settling.at_rest or self._settling.is_near(q, self._held_at):
            return
        self._stop(ReasonCode.TRACKING_ERROR)
        if self._settling.goes_on(q):
            self._end_motion()

    def _end_motion(self) -> None:
        if not self.motion_stop:
            self.motion_stop = True
            self.counters["motion_stops"] += 1

    def _probe(self, measured: Measurement) -> None:
        if measured.cycle_fault and self._mode.idle:
            return  # a probe in another cycle would tell nothing
        known = self._mode.mode
        self._mode.cycle(measured.q, measured.ipoc, measured.missed_last)
        if self._mode.mode in (Mode.RELATIVE, Mode.ADRIFT) and known is Mode.UNKNOWN:
            self.counters["modes_refused"] += 1
        if self._mode.mode is Mode.ADRIFT:
            self._end_motion()
        if self._mode.lags and self._lag is None:
            self._lag = self._new_lag_watch(self._held_at, self._mode.lags)

    def _watch_lag(self) -> None:
        """Measure the lag in the last cycle, after its reply and before its state is published."""
        last, self._unwatched = self._unwatched, None
        if last is None or self._lag is None:
            return
        measured, q_cmd = last
        self._lag.cycle(measured.q, measured.ipoc, measured.missed_last, q_cmd)
        if self._lag.fault:
            self._mode.lags_too_long(self._lag.fault)

    def _rest(self) -> None:
        self._motion = SetpointMotion.at_rest(self._motion.q_cmd, self._motion.sequence)

    def _barred(self, measured: Measurement) -> ReasonCode | None:
        """Why no reset lets the robot be driven now; None if one may."""
        if measured.cycle_fault:
            return ReasonCode.CYCLE_MISMATCH
        if not self.guarded:
            return ReasonCode.CRASH_BRAKE_LOST
        return self._mode.reason if self._mode.bars else None

    def _supervise(self, supervision: Supervision | None, measured: Measurement) -> None:
        if supervision is None:
            self._cycles_without_gate += 1
            if self._cycles_without_gate > self._gate_timeout_cycles:
                self._stop(ReasonCode.GATE_LOST)
            return
        if supervision.cell != self._identity:
            self.counters["supervision_of_another_cell"] += 1
            self._stop(supervision.stop or ReasonCode.CELL_MISMATCH)
            return
        self._cycles_without_gate, self._tool = 0, supervision.tool
        if measured.cycle_fault:
            refused: ReasonCode | None = ReasonCode.CYCLE_MISMATCH
        else:
            refused = self._mode.reason if self._mode.refused else None
        known = self._mode.known and measured.cycle_known
        if self._phase is Phase.OFFLINE and self.guarded and (known or refused is not None):
            self._epoch = supervision.epoch
            self._resets = supervision.resets  # these were given to an earlier process
            self._enter(Event.LINKED)
        if refused is not None:
            self._stop(refused)
        elif self._reason is ReasonCode.CYCLE_MISMATCH and measured.cycle_known:
            self._reason = ReasonCode.KRC_LOST  # its own cycle is back, and only a reset is missing
        if self._barred(measured) is not None:
            self._resets = max(self._resets, supervision.resets)  # one given now shall not be obeyed some day
        may_be_reset = self._phase is Phase.HELD and known and self._motion.rests
        is_asked = may_be_reset and supervision.resets > self._resets
        if is_asked and self._settling.is_near(measured.q, self._held_at):
            self._motion, self._q_reset = replace(self._motion, q_cmd=self._held_at, sequence=0), None
            self.motion_stop = False
            self._resets = supervision.resets
            self._epoch = supervision.epoch
            self._cycles_missed = 0
            self._reason = None
            self._enter(Event.RESET)
        if supervision.epoch != self._epoch:
            self._stop(ReasonCode.GATE_LOST)
        elif supervision.stop is not None:
            self._stop(supervision.stop)
        self.outputs.update({k: v for k, v in supervision.outputs.items() if k in self.outputs})

    def _keep(self, admission: Admission) -> None:
        """Keep an admission until its cycle; until then nothing else is known of it than that it is not too late."""
        if self._cycle == 0:
            self.counters["admission_while_not_ready"] += 1
            return
        why = self._admissions.put(admission, self._cycle)
        if why is not None:
            self.counters[why] += 1

    def _advance(self, follows: ServerState | None) -> None:
        admission = None if follows is None else self._admissions.take(follows.cycle)
        if follows is None or self._phase not in MAY_MOVE or follows.phase not in MAY_MOVE:
            # nothing goes on after a hold that was asked for before it
            forgotten = self._admissions.forget() + (admission is not None)
            self.counters.update({"admission_while_not_ready": forgotten} if forgotten else {})
            admission = None
        refused = None if admission is None or follows is None else self._refused(admission, follows)
        if admission is not None and refused is None:
            self._motion = self._motion.admitted(admission)
            self._enter(Event.ADMITTED)
        else:
            if not self._motion.rests:
                self.counters["braked_cycles"] += 1
                self.counters[f"braked_cycles_{self._reason or refused or 'no_admission'}"] += 1
            self._motion = self._motion.braked()
            self._enter(Event.STARVED)
        if self._motion.rests:
            self._enter(Event.RESTED)

    def _refused(self, admission: Admission, state: ServerState) -> Refusal | None:
        why = refusal(admission, state, self._bounds)
        if why is None:
            self.counters["admissions"] += 1
        else:
            self.counters[why] += 1
        return why

    def _stop(self, reason: ReasonCode) -> None:
        was = self._phase
        self._enter(Event.STOPPED)
        if self._phase is Phase.HELD and was is not Phase.HELD:
            self._reason = reason
            self.counters[f"held_{reason}"] += 1

    def _enter(self, event: Event) -> None:
        self._phase = next_phase(self._phase, event)

    def _publishable(self, measured: Measurement, time_s: float) -> ServerState:
        barred = self._barred(measured) if self._phase is Phase.HELD else None  # that stands before all else
        return ServerState(
            robot=self.robot,
            process=self.process,
            cycle=self._cycle,
            ipoc=measured.ipoc,
            time_s=time_s,
            q=tuple(measured.q.tolist()),
            q_cmd=tuple(self._motion.q_cmd.tolist()),
            q_reset=None if self._q_reset is None else tuple(self._q_reset.tolist()),
            dq=tuple(self._motion.dq.tolist()),
            plan=self._motion.plan,
            epoch=self._epoch,
            sequence=self._motion.sequence,
            phase=self._phase,
            reason=barred or self._reason,
            resets=self._resets,
            inputs=dict(measured.inputs),
            outputs=self.outputs,
            counters=dict(self.counters),
            cell=self._identity,
            lag_s=() if self._lag is None else self._lag.lag_s(),
            tool=self._tool,
        )


_STOP_CYCLES = 3
"""Replies that carry the stop before the process ends: one or two may be lost."""


class Ending:
    """The end of the process: the robot comes to rest first, and its KRC gets the signal to end the motion.

    SIGTERM and Ctrl-C: the first asks for an end, the second ends at once.

    Args:
        server: brings the robot to rest.

    Attributes:
        stop: whether the KRC has to end the motion, because no process will answer it any more.
        over: the process may end.
    """

    def __init__(self, server: RobotServer) -> None:
        self.stop = False
        self.over = False
        self._server = server
        self._asked = False
        self._stops_sent = 0
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask)

    def cycle_passed(self) -> None:
        """End a cycle: the KRC was answered, or is silent."""
        if not self._asked:
            return
        self._server.end()
        self._stops_sent += self.stop
        self.stop = self._server.at_rest
        self.over = self._stops_sent >= _STOP_CYCLES

    def krc_silent(self) -> None:
        """The KRC cannot be answered: there is nothing to wait for."""
        self.over = self._asked

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True
