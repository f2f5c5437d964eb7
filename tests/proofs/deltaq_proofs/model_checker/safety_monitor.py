"""What must hold, kept apart from the code that shall keep it: a record of certificates, stops and resets.

It sees only what passes between the programs and what the KRC is sent, and believes no counter of theirs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np

from deltaq_proofs.model_checker.one_joint import FASTEST, GATE_TIMEOUT_CYCLES, KRC_TIMEOUT_CYCLES
from deltaq_protocol.brake import brake_travel
from deltaq_protocol.guarded import Admission, ServerState
from deltaq_protocol.messages import Phase

REST_WITHIN_CYCLES = 1 + FASTEST
"""One admission may be in flight when a stop is taken; its brake follows."""

_MOVING = (Phase.READY, Phase.ENGAGED, Phase.BRAKING)


class Property(StrEnum):
    """What the explorer shows."""

    CERTIFIED = "never motion without a live certificate"
    KNOWN = "the gate reckons with every course that the robot may take"
    LATCHED = "held is left only by a reset with the cause gone"
    STOPPED = "after a stop the robot rests within a bounded number of cycles, and until a reset"
    NOTICED = "silence of the gate or the KRC, and the first order of a stop, hold the robot"
    ONCE = (
        "an increment moves the robot once, never after a newer one, a stop, a reset or the end of its lease"
    )
    EXPLAINED = "the KRC is moved by nothing but increments that were certified, and by a reset not at all"
    UNHEARD = "nobody who is not the KRC changes anything while the KRC is heard"


class Violation(Exception):  # noqa: N818 it is no error of the program, but what the explorer looks for
    """A property does not hold."""

    def __init__(self, broken: Property, what: str) -> None:
        super().__init__(f"{broken}: {what}")
        self.broken = broken


@dataclass(frozen=True)
class Telegram:
    """One telegram of the KRC and what the Robot Server made of it.

    Attributes:
        before: the state before; None for a Robot Server that has just started.
        after: the state after.
        admissions: what was handed to it, now or before, that may still have been due.
        order_of_stop: the heartbeat handed to it was sent after a stop that no reset has followed.
        gate_heard: a heartbeat was handed to it.
        missed: the KRC did not get the last reply.
        begins: the telegram begins a session.
    """

    before: ServerState | None
    after: ServerState
    admissions: tuple[Admission, ...]
    order_of_stop: bool
    gate_heard: bool
    missed: bool
    begins: bool


@dataclass(frozen=True, slots=True)
class SafetyMonitor:
    """What is owed.

    Attributes:
        course: increments that are certified and still to be sent, the rest of a brake [m].
        since_stop: answered telegrams since a stop that no reset has followed; None without one.
        reset_given: a reset was accepted and not used up; a stop may follow while its order is on its way.
        gate_silent: telegrams since the gate was heard.
        missed: replies missed in a row.
        silence_told: the newest state that the gate took in repeats a cycle, as it does while the KRC is silent.
        began_anew: the Robot Server crashed and has not been held since; an order in flight was not for this process.
    """

    course: tuple[float, ...] = ()
    since_stop: int | None = None
    reset_given: bool = False
    gate_silent: int = 0
    missed: int = 0
    silence_told: bool = False
    began_anew: bool = False

    def stop_taken(self) -> SafetyMonitor:
        """The gate took a stop."""
        return replace(self, since_stop=self.since_stop or 0)

    def reset_accepted(self, believed: ServerState) -> SafetyMonitor:
        """The gate accepted a reset, of a robot that it believes to be in this state."""
        if believed.phase is not Phase.HELD:
            return self  # there is nothing to reset
        if self.silence_told:
            raise Violation(Property.LATCHED, "a reset was accepted while the KRC is known to be silent")
        return replace(self, since_stop=None, reset_given=True)

    def krc_silent(self) -> SafetyMonitor:
        """The KRC fell silent: it holds its last correction, and the robot stands there."""
        return replace(self, course=())

    def server_crashed(self, offline: bool) -> SafetyMonitor:
        """The Robot Server restarted: the KRC stands where it was last sent, and that is as good as a stop.

        One that the gate never reached had nothing to forget.
        """
        monitor = replace(self, course=(), gate_silent=0, missed=0)
        return monitor if offline else replace(monitor, since_stop=self.since_stop or 0, began_anew=True)

    def gate_crashed(self, offline: bool) -> SafetyMonitor:
        """The gate restarted; a robot that it never reached is not held by what it had ordered."""
        return replace(self, since_stop=None if offline else self.since_stop, silence_told=False)

    def telegram(self, telegram: Telegram) -> SafetyMonitor:
        """Judge one telegram.

        Raises:
            Violation: if a property does not hold.
        """
        after = telegram.after
        monitor = replace(
            self,
            course=self._course(telegram),
            gate_silent=0 if telegram.gate_heard else min(self.gate_silent + 1, GATE_TIMEOUT_CYCLES + 1),
            missed=min(self.missed + 1, KRC_TIMEOUT_CYCLES + 1) if telegram.missed else 0,
        )
        if _was_reset(telegram):
            monitor = replace(monitor, missed=int(telegram.missed))  # a reset lets the count begin anew
        if self.since_stop is not None and not telegram.missed:
            monitor = replace(monitor, since_stop=min(self.since_stop + 1, REST_WITHIN_CYCLES))
        monitor._rests(telegram)
        monitor._noticed(telegram)
        was_held = telegram.before is not None and telegram.before.phase is Phase.HELD
        if was_held and (after.phase is not Phase.HELD or _was_reset(telegram)):
            return monitor._left_held(self.course, telegram)
        if after.phase is Phase.HELD and (telegram.before is None or telegram.before.phase is not Phase.HELD):
            return replace(monitor, reset_given=False, began_anew=False)
        return monitor

    def _course(self, telegram: Telegram) -> tuple[float, ...]:
        """What is left of the certified course after this telegram."""
        before, after = telegram.before, telegram.after
        if telegram.missed:
            if before is not None and after.q_cmd != before.q_cmd:
                raise Violation(Property.CERTIFIED, "the setpoint moved though the last reply was missed")
            return self.course
        if before is None or telegram.begins:
            if any(after.dq):
                raise Violation(Property.CERTIFIED, "a session began with motion")
            if before is not None and before.phase is not Phase.OFFLINE and after.q_cmd != before.q_cmd:
                raise Violation(Property.CERTIFIED, "a session moved the setpoint before a reset")
            return ()
        if _was_reset(telegram) and before.q_reset is not None:
            if after.q_cmd != before.q_reset or any(after.dq):
                raise Violation(Property.CERTIFIED, "a reset took a setpoint that the KRC did not have")
            return ()
        moved = after.q_cmd[0] - before.q_cmd[0]
        if after.sequence != before.sequence and after.sequence != 0:
            admission = next((one for one in telegram.admissions if one.sequence == after.sequence), None)
            dead = _dead(admission, telegram)
            if dead or admission is None:
                raise Violation(
                    Property.CERTIFIED, f"an admission was taken {dead or 'that was not handed in'}"
                )
            if moved != admission.dq[0]:
                raise Violation(Property.CERTIFIED, "the increment sent is not the one admitted")
            return _brake(admission)
        expected = self.course[0] if self.course else 0.0
        if moved != expected:
            raise Violation(Property.CERTIFIED, f"the setpoint moved by {moved:g}, certified is {expected:g}")
        return self.course[1:]

    def _rests(self, telegram: Telegram) -> None:
        if (
            self.since_stop == REST_WITHIN_CYCLES
            and not telegram.missed
            and telegram.before
            and any(telegram.after.dq)
        ):
            raise Violation(Property.STOPPED, f"moving more than {REST_WITHIN_CYCLES} cycles after a stop")

    def _noticed(self, telegram: Telegram) -> None:
        if telegram.after.phase not in _MOVING:
            return
        if self.gate_silent > GATE_TIMEOUT_CYCLES:
            raise Violation(Property.NOTICED, f"{telegram.after.phase} though the gate fell silent")
        if self.missed > KRC_TIMEOUT_CYCLES:
            raise Violation(Property.NOTICED, f"{telegram.after.phase} though replies are missed for long")
        if telegram.order_of_stop and self.since_stop is not None and not self.began_anew:
            raise Violation(
                Property.NOTICED, f"{telegram.after.phase} though a stop was taken and its order came"
            )

    def _left_held(self, course: tuple[float, ...], telegram: Telegram) -> SafetyMonitor:
        if not self.reset_given:
            raise Violation(Property.LATCHED, "left without a reset that was accepted since it was entered")
        if any(course) or any(telegram.after.dq):
            raise Violation(Property.LATCHED, "left before the robot came to rest")
        return replace(self, reset_given=False)


def _was_reset(telegram: Telegram) -> bool:
    return telegram.before is not None and telegram.after.resets != telegram.before.resets


def _dead(admission: Admission | None, telegram: Telegram) -> str:
    """Why an admission is none to be taken now; empty if it lives."""
    before = telegram.before
    if admission is None or before is None:
        return "that was not handed in"
    if telegram.after.phase is Phase.HELD or before.phase is Phase.OFFLINE:
        return f"by a robot that is {telegram.after.phase}"
    if admission.epoch != before.epoch:
        return "from a gate that is not this robot's"
    if admission.cycle != before.cycle:
        return f"for cycle {admission.cycle}, a state older than {before.cycle}"
    if (admission.follows_q_cmd, admission.follows_dq) != (before.q_cmd, before.dq):
        return "that follows what the robot is not doing"
    return ""


def _brake(admission: Admission) -> tuple[float, ...]:
    """The increments after an admission, from the sums of what is still to travel."""
    n = admission.brake_cycles
    left = [float(brake_travel(np.array(admission.dq), n, step)[0]) for step in range(n + 1)]
    return tuple(sooner - later for sooner, later in pairwise(left) if sooner != later)
