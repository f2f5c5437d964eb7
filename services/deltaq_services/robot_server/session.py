"""Sessions of a KRC: recognizes the begin of a session, and the telegrams that belong to it.

A session is RSI running from one RSI_ON to its end: its corrections are offsets from its start position. A new
session changes the meaning of every correction, so one telegram is never enough to accept it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.endpoint import Address
from deltaq_protocol.rsi import KrcTelegram
from deltaq_services.containment import Part

LIMIT_MARGIN_RAD = 0.35
LIMIT_MARGIN_M = 0.2
"""How far outside its limits a joint may be reported. A cell's limits lie inside those of the robot, and an operator
may have jogged it there; a robot further out is not driven."""

VELOCITY_MARGIN = 1.5
"""How much faster than its limit a joint may be reported to move: servos overshoot, telegrams are not evenly apart."""

RESOLUTION_RAD = 0.0035
RESOLUTION_M = 0.0002
"""Rounding of two telegrams: a controller with one decimal rounds to 0.1 deg or mm."""


@dataclass(frozen=True, slots=True)
class Plausibility:
    """Bounds of plausible positions and motions of one robot's joints, each (n,) [rad or m].

    A KRC's telegram has no checksum beyond UDP's, and any host on the network can forge one. A position is accepted
    if the robot can be there, and if the joints can have moved there since the last one.

    Attributes:
        joints: names, for messages.
        lower: least accepted position.
        upper: greatest accepted position.
        reach: largest motion of a joint in one cycle.
        resolution: rounding of a distance by the telegram's decimals.
    """

    joints: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    reach: tuple[float, ...]
    resolution: tuple[float, ...]

    @classmethod
    def of(cls, robot: RobotDescription, cycle_s: float) -> Plausibility:
        """The bounds of a robot with sample time `cycle_s`."""
        margin = [LIMIT_MARGIN_RAD if unit == "rad" else LIMIT_MARGIN_M for unit in robot.units]
        return cls(
            robot.joint_names,
            tuple((robot.lower - margin).tolist()),
            tuple((robot.upper + margin).tolist()),
            tuple((VELOCITY_MARGIN * cycle_s * robot.max_velocity).tolist()),
            tuple(RESOLUTION_RAD if unit == "rad" else RESOLUTION_M for unit in robot.units),
        )

    def of_place(self, q: Sequence[float]) -> str | None:
        """Why no robot can be at `q` (n,) [rad or m], or None."""
        for joint, value, lower, upper in zip(self.joints, q, self.lower, self.upper, strict=True):
            if not value >= lower:
                return _words(joint, "is below its limit and a margin", value, lower)
            if not value <= upper:
                return _words(joint, "is above its limit and a margin", value, upper)
        return None

    def of_motion(self, q: Sequence[float], last: Sequence[float], cycles: int) -> str | None:
        """Why a robot that was at `last` cannot be at `q` (n,) [rad or m] that many cycles later, or None."""
        for number, joint in enumerate(self.joints):
            bound = cycles * self.reach[number] + self.resolution[number]
            distance = abs(q[number] - last[number])
            if not distance <= bound:
                return _words(joint, f"cannot have moved so far in {cycles} cycles", distance, bound)
        return None


def _words(joint: str, what: str, value: float, bound: float) -> str:
    return f"{joint} {what}: {value:.6g}, allowed {bound:.6g} (rad or m)"


class DatagramSource(StrEnum):
    """Where a datagram comes from; all but the KRC's are dropped, and counted under these names."""

    KRC = "telegrams_from_krc"
    FOREIGN = "telegrams_foreign"
    """From another address than the cell gives to the KRC, or from no port that could be answered."""
    SECOND_KRC = "telegrams_second_krc"
    """From the right address, but another port than that of the KRC that is being answered."""


class Peer(Part):
    """Judges senders: only the KRC whose telegrams were believed is answered.

    Its port is not configured: a KRC, and an emulator, choose one when they start. The port of the first valid telegram
    is kept until the KRC has been silent for `silence_s`; then the next valid telegram determines it.

    Args:
        krc_address: the KRC's address; None on the loopback, where any sender may be the first.
        silence_s: time of silence after which the KRC may send from another port [s].

    Attributes:
        address: of the KRC; None while it is not known.
        stranger: the last dropped sender, as text; empty without one.
    """

    def __init__(self, krc_address: str | None, silence_s: float) -> None:
        self.address: Address | None = None
        self.stranger = ""
        self._krc_address = krc_address
        self._silence_s = silence_s
        self._heard_s = 0.0

    def judge(self, sender: Address, now_s: float) -> DatagramSource:
        """The sender of a datagram, before a byte of it is read.

        Args:
            sender: its address and port.
            now_s: on a monotonic clock.
        """
        if sender == self.address:
            return DatagramSource.KRC
        host, port = sender
        if port == 0 or self._krc_address not in (None, host):
            self.stranger = f"a foreign sender at {host}:{port}"
            return DatagramSource.FOREIGN
        if self.address is None or now_s - self._heard_s > self._silence_s:
            return DatagramSource.KRC
        self.stranger = f"a second KRC at {host}:{port}"
        return DatagramSource.SECOND_KRC

    def believed(self, sender: Address, now_s: float) -> None:
        """Note a valid telegram of this sender."""
        if sender != self.address:
            self.stranger = ""  # it may have been this one
        self.address, self._heard_s = sender, now_s


CONFIRMATIONS = 4
"""Number of consistent telegrams in a row before a session is accepted. Two agree when one is duplicated, three give
the IPOC's step twice; the fourth allows for one forged or garbled telegram. A KRC that permits ten late
replies, as it does unless told otherwise, waits for four."""

PACE = 0.5
"""Fraction of their own time in which such telegrams may come: forged ones may come in a burst, a KRC's cannot."""

STILL = 1e-5
"""Change of a joint between telegrams that counts as standing still [rad or m]."""

IPOC_WRAP = 2**32
_LARGEST_STEP = 1000
_OVERTAKEN_CYCLES = 100
"""A telegram this far behind may have been overtaken on the link; one further behind has another clock."""

_JITTER_CYCLES = 3
"""How far the IPOC may run ahead of the elapsed time: less than it takes to believe in another session, so that
one garbled stamp does not end the session whose telegrams then seem overtaken."""


class Belief(StrEnum):
    """Whether a session of telegrams is believed."""

    UNKNOWN = "unknown"
    """No session was believed yet."""
    BELIEVED = "believed"
    """A session is believed."""
    DOUBTED = "doubted"
    """A session was believed, and telegrams come that do not belong to it."""


class TelegramKind(StrEnum):
    """Kind of a telegram with respect to the believed session."""

    NEXT = "next"
    """It follows the last one soon enough, and its programmed position is the same."""
    REPEATED = "repeated"
    """It is a duplicate, or was overtaken on the link."""
    GARBLED = "garbled"
    """It follows the last one, and a position in it cannot be true."""
    FOREIGN = "foreign"
    """It belongs to another session, or to none."""
    CONFIRMED = "confirmed"
    """Enough consistent telegrams at rest have come while the session was silent: a new session is accepted."""


class Answer(StrEnum):
    """The answer to a telegram."""

    SETPOINT = "setpoint"
    """The correction of this cycle."""
    LAST = "last"
    """The correction that was sent last, again."""
    UNMOVED = "unmoved"
    """The correction that the KRC has according to the telegram; none where that might move the robot."""
    NOTHING = "nothing"
    """No answer."""


class Judgement(NamedTuple):
    """Kind of a telegram, its answer, and why a garbled one is garbled."""

    kind: TelegramKind
    answer: Answer
    why: str = ""


@dataclass(frozen=True)
class SessionTransition:
    """In `belief`, a telegram of `kind` is answered with `answer` and leads to `next_belief`."""

    belief: Belief
    kind: TelegramKind
    answer: Answer
    next_belief: Belief


AUTOMATON: tuple[SessionTransition, ...] = (
    SessionTransition(Belief.UNKNOWN, TelegramKind.FOREIGN, Answer.UNMOVED, Belief.UNKNOWN),
    SessionTransition(Belief.UNKNOWN, TelegramKind.REPEATED, Answer.NOTHING, Belief.UNKNOWN),
    SessionTransition(Belief.UNKNOWN, TelegramKind.CONFIRMED, Answer.SETPOINT, Belief.BELIEVED),
    SessionTransition(Belief.BELIEVED, TelegramKind.NEXT, Answer.SETPOINT, Belief.BELIEVED),
    SessionTransition(Belief.BELIEVED, TelegramKind.REPEATED, Answer.NOTHING, Belief.BELIEVED),
    SessionTransition(Belief.BELIEVED, TelegramKind.GARBLED, Answer.LAST, Belief.BELIEVED),
    SessionTransition(Belief.BELIEVED, TelegramKind.FOREIGN, Answer.UNMOVED, Belief.DOUBTED),
    SessionTransition(Belief.DOUBTED, TelegramKind.NEXT, Answer.SETPOINT, Belief.BELIEVED),
    SessionTransition(Belief.DOUBTED, TelegramKind.REPEATED, Answer.NOTHING, Belief.DOUBTED),
    SessionTransition(Belief.DOUBTED, TelegramKind.GARBLED, Answer.NOTHING, Belief.DOUBTED),
    SessionTransition(Belief.DOUBTED, TelegramKind.FOREIGN, Answer.UNMOVED, Belief.DOUBTED),
    SessionTransition(Belief.DOUBTED, TelegramKind.CONFIRMED, Answer.SETPOINT, Belief.BELIEVED),
)
"""The automaton of a session: one of these rows applies to every telegram."""

_ROWS = {(row.belief, row.kind): row for row in AUTOMATON}


@dataclass(frozen=True, slots=True)
class Run:
    """Telegrams in a row that may be those of another session."""

    count: int
    first_s: float
    step: int | None
    newest: KrcTelegram


class Session(Part):
    """Follows the sessions of one KRC by its telegrams.

    Args:
        cycle_s: sample time.
        silence_s: time after which a KRC counts as silent.
        ipoc_step: increase of the IPOC in a cycle; None: learned from the first telegrams of a session.
        plausible: bounds of positions.
        near: (n,) greatest distance from the setpoint [rad or m].

    Attributes:
        belief: the present state of the session.
        step: increase of the IPOC in a cycle; None while it is not known.
        last: the newest telegram of the session; None before the first.
    """

    def __init__(
        self, cycle_s: float, silence_s: float, ipoc_step: int | None, plausible: Plausibility, near: Array
    ) -> None:
        self.belief = Belief.UNKNOWN
        self.step = ipoc_step
        self.last: KrcTelegram | None = None
        self._given_step = ipoc_step
        self._plausible = plausible
        self._near = near
        self._cycle_s = cycle_s
        self._silence_s = silence_s
        self._silence_cycles = max(1, round(silence_s / cycle_s))
        self._least_s = PACE * (CONFIRMATIONS - 1) * cycle_s
        self._time_s = 0.0
        self._run: Run | None = None

    def judge(self, telegram: KrcTelegram, time_s: float) -> Judgement:
        """Kind of a telegram, and its answer.

        Args:
            telegram: it has a position where the robot can be.
            time_s: when it arrived, on a monotonic clock.
        """
        kind, why = self._kind(telegram, time_s)
        if kind is TelegramKind.NEXT:
            self._goes_on(telegram, time_s)
        if kind in (TelegramKind.NEXT, TelegramKind.GARBLED):
            self._run = None
        else:
            grew = self._follow(telegram, time_s)
            if kind is TelegramKind.REPEATED and grew:
                kind = TelegramKind.FOREIGN  # two that follow one another are a clock set back
            if kind is TelegramKind.FOREIGN and self._confirmed(time_s):
                kind = TelegramKind.CONFIRMED
        row = _ROWS[self.belief, kind]
        if kind is not TelegramKind.CONFIRMED:
            self.belief = row.next_belief
        return Judgement(kind, row.answer, why)

    def believe(self, telegram: KrcTelegram, time_s: float) -> None:
        """Begin the session that was confirmed by this telegram."""
        assert self._run is not None  # it was confirmed by a run
        self.belief, self.step, self._run = Belief.BELIEVED, self._run.step, None
        self._goes_on(telegram, time_s)

    def interrupted(self) -> None:
        """A telegram says that RSI restarts."""
        self._run = None
        if self.belief is Belief.BELIEVED:
            self.belief = Belief.DOUBTED

    def _goes_on(self, telegram: KrcTelegram, time_s: float) -> None:
        self.last, self._time_s = telegram, time_s

    def _kind(self, telegram: KrcTelegram, time_s: float) -> tuple[TelegramKind, str]:
        repeats = self._run is not None and self._run.newest.ipoc == telegram.ipoc
        other = TelegramKind.REPEATED if repeats else TelegramKind.FOREIGN
        last = self.last
        if last is None:
            return other, ""
        assert self.step is not None  # a session has the step of the telegrams that it began with
        step = self.step
        behind = (last.ipoc - telegram.ipoc) % IPOC_WRAP
        if behind % step == 0 and behind <= _OVERTAKEN_CYCLES * step:
            return TelegramKind.REPEATED, ""
        ahead = (telegram.ipoc - last.ipoc) % IPOC_WRAP
        passed = (time_s - self._time_s) / self._cycle_s + _JITTER_CYCLES
        if ahead % step or ahead > min(self._silence_cycles, passed) * step:
            return other, ""
        if not _same(telegram.q_programmed, last.q_programmed):
            if self._stands_where_programmed(telegram):
                return TelegramKind.FOREIGN, ""
            return TelegramKind.GARBLED, "its programmed position is neither the session's nor the robot's"
        assert telegram.q is not None  # asked only of telegrams with a position
        assert last.q is not None  # the session consists of such
        fault = self._plausible.of_motion(telegram.q.tolist(), last.q.tolist(), ahead // step)
        return (TelegramKind.NEXT, "") if fault is None else (TelegramKind.GARBLED, fault)

    def _stands_where_programmed(self, telegram: KrcTelegram) -> bool:
        if telegram.q is None or telegram.q_programmed is None:
            return False
        return bool((np.abs(telegram.q - telegram.q_programmed) <= self._near).all())

    def _follow(self, telegram: KrcTelegram, time_s: float) -> bool:
        """Count a telegram that is not the session's; whether it agrees with the one before."""
        run = self._run
        if run is not None:
            step = (telegram.ipoc - run.newest.ipoc) % IPOC_WRAP
            if step == 0:
                return False
            if (
                step == (self._given_step or run.step or step)
                and step <= _LARGEST_STEP
                and _same(telegram.q_programmed, run.newest.q_programmed)
                and _same(telegram.q, run.newest.q)
            ):
                self._run = Run(run.count + 1, run.first_s, step, telegram)
                return True
        self._run = Run(1, time_s, None, telegram)
        return False

    def _confirmed(self, time_s: float) -> bool:
        run = self._run
        if self.last is not None and time_s - self._time_s < self._silence_s:
            return False  # a KRC that was not silent has not restarted: some of its telegrams were lost
        return run is not None and run.count >= CONFIRMATIONS and time_s - run.first_s >= self._least_s


def _same(one: Array | None, other: Array | None) -> bool:
    if one is other:
        return True
    if one is None or other is None:
        return False
    return bool((np.abs(one - other) < STILL).all())
