"""The brake of a robot whose Robot Server has died: its replies from the last record on, and nothing but that brake.

Pure: no clock, no socket. The KRC is answered with the next setpoint of the certified brake, then with the last one
again and the signal that ends the motion. Wherever it is not known that the KRC has the last reply, that one is sent
once more: between two replies lies one cycle's travel at most.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Self

from deltaq_services.robot_server.crash_brake.record import LastReply, PeerAddress
from deltaq_services.robot_server.reply_guard import reply_fault

MAX_IPOC = 2**32 - 1
_IPOC, _IPOC_ENDS = b"<IPOC>", b"</IPOC>"
_LATE = b'<Delay D="'
_MOST_LATE = 2**62
"""A count that fits into a record, however many digits it was written with."""


class PlainTelegram(NamedTuple):
    """The contents of such a telegram.

    Attributes:
        ipoc: time stamp.
        late: late replies so far, as the controller counts them; 0 if it does not send them.
        programmed: checksum of its programmed position, as it was written; of nothing, if it does not send one.
    """

    ipoc: int
    late: int
    programmed: int


class PlainTelegrams:
    """Reads telegrams of one robot with bytes and tuples alone, for a process that loads neither numpy nor zenoh.

    The pattern is compiled by `usual_telegram`, the template of replies by `SensorCodec`, both from the KRC's file.

    Args:
        pattern: regular expression of a whole telegram.
        elements: beginnings of the elements that hold the programmed position.
        most_bytes: of a telegram.
    """

    def __init__(self, pattern: str, elements: Sequence[str], most_bytes: int) -> None:
        self._match = re.compile(pattern.encode()).fullmatch
        self._elements = tuple(element.encode() for element in elements)
        self._most_bytes = most_bytes

    def read(self, datagram: bytes) -> PlainTelegram | None:
        """Read a datagram; None if it is no telegram of this robot in the usual layout."""
        if len(datagram) > self._most_bytes or self._match(datagram) is None:
            return None
        ipoc = int(datagram[datagram.rindex(_IPOC) + len(_IPOC) : datagram.rindex(_IPOC_ENDS)])
        if ipoc > MAX_IPOC:
            return None
        late = 0
        if (place := datagram.find(_LATE)) >= 0:
            begins = place + len(_LATE)
            try:
                late = int(float(datagram[begins : datagram.index(b'"', begins)]))
            except ValueError:
                return None
            late = bounded(late)
        return PlainTelegram(ipoc, late, self.programmed(datagram))

    def programmed(self, datagram: bytes) -> int:
        """The checksum of the programmed position in a telegram of the usual layout."""
        programmed = 0
        for element in self._elements:
            begins = datagram.index(element)
            programmed = zlib.crc32(datagram[begins : datagram.index(b">", begins)], programmed)
        return programmed


def bounded(late: int) -> int:
    """A count of late replies, bounded to the field of a record."""
    return max(-_MOST_LATE, min(late, _MOST_LATE))


PORT_PATIENCE_S = 3.0
"""How long a Robot Server waits for its port: the brake of one that died is over by then."""

STOP_CYCLES = 3
"""Replies that carry the stop: one or two may be lost."""

_JITTER_CYCLES = 3
"""How far the IPOC may run ahead of the elapsed time."""


@dataclass(frozen=True)
class CrashPlan:
    """What does not change while a Robot Server lives.

    Attributes:
        pattern, elements, most_bytes: of telegrams, see `PlainTelegrams`.
        template: of a reply, with a place for each of `places`.
        places: indices into corrections, outputs, IPOC and stop.
        commanded: (n,) deg or mm of a correction per rad or m.
        outputs: number of digital outputs.
        most: (n,) that a joint may travel in one cycle [rad or m].
        cycle_s: sample time.
        silence_s: after which a KRC counts as silent.
        lag_cycles: cycles within which the drives are where they were sent.
        has_stop: whether the cell names a signal that ends the motion.
    """

    pattern: str
    elements: tuple[str, ...]
    most_bytes: int
    template: str
    places: tuple[int, ...]
    commanded: tuple[float, ...]
    outputs: int
    most: tuple[float, ...]
    cycle_s: float
    silence_s: float
    lag_cycles: int
    has_stop: bool

    def telegrams(self) -> PlainTelegrams:
        """What reads the robot's telegrams."""
        return PlainTelegrams(self.pattern, self.elements, self.most_bytes)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read a plan written by `json`."""
        values: dict[str, Any] = json.loads(text)
        for name, value in values.items():
            values[name] = tuple(value) if isinstance(value, list) else value
        return cls(**values)

    def json(self) -> str:
        """The plan in one line."""
        return json.dumps(asdict(self))


class CrashBrake:
    """The replies to one KRC.

    Args:
        plan: the robot's plan.
        found: the record that its Robot Server left.
        telegrams: reads telegrams; made in advance, since that takes most of a cycle.

    Attributes:
        over: whether no further answer is needed.
        correction: (n,) the correction that was sent last [rad or m].
        replies: number of replies sent so far.
        at_rest: whether the brake has been sent to its end.
    """

    def __init__(self, plan: CrashPlan, found: LastReply, telegrams: PlainTelegrams) -> None:
        record = found.record
        self.correction = record.correction
        self.replies = 0
        self._plan, self._record, self._peer = plan, record, found.peer
        self._telegrams = telegrams
        self._template = plan.template.encode()
        self._is_sent = found.was_sent
        self._time_s, self._ipoc, self._late = found.time_s, record.ipoc, record.late
        self._step = record.step
        self._silence_cycles = max(1, round(plan.silence_s / plan.cycle_s))
        self._to_repeat = self._silence_cycles
        self._to_settle = 0 if record.rests else plan.lag_cycles
        self._to_stop = STOP_CYCLES if plan.has_stop else 0
        self.over = self.at_rest and self._is_done

    @property
    def at_rest(self) -> bool:
        """Whether the brake was sent to its end."""
        return self._step >= self._record.brake_cycles

    @property
    def silent_s(self) -> float:
        """When the KRC counts as silent, on the monotonic clock."""
        return self._time_s + self._plan.silence_s

    def time_passed(self, now_s: float) -> None:
        """End the brake if the KRC was silent for too long.

        It has held its last correction, and the rest of the brake would move it.
        """
        self.over = self.over or not now_s < self.silent_s

    def answer(self, waiting: Sequence[tuple[bytes, PeerAddress]], now_s: float) -> bytes | None:
        """The reply to the newest telegram of all that wait; older ones are past their time.

        Args:
            waiting: datagrams and their senders, oldest first.
            now_s: on the monotonic clock.

        Returns:
            None if none of them is a telegram that follows.
        """
        self.time_passed(now_s)
        for datagram, sender in reversed(waiting):
            if self.over:
                return None
            telegram = self._telegrams.read(datagram) if sender == self._peer else None
            if telegram is not None and self._follows(telegram, now_s):
                return self._reply(telegram, now_s)
        return None

    @property
    def _is_done(self) -> bool:
        return self._to_settle <= 0 and self._to_stop <= 0

    def _follows(self, telegram: PlainTelegram, now_s: float) -> bool:
        step = self._record.ipoc_step
        ahead = (telegram.ipoc - self._ipoc) % (MAX_IPOC + 1)
        passed = (now_s - self._time_s) / self._plan.cycle_s + _JITTER_CYCLES
        if ahead == 0 or ahead % step or ahead > min(self._silence_cycles, passed) * step:
            return False
        return telegram.programmed == self._record.programmed

    def _reply(self, telegram: PlainTelegram, now_s: float) -> bytes:
        missed = not self._is_sent or telegram.late > self._late
        self._ipoc, self._late, self._time_s, self._is_sent = telegram.ipoc, telegram.late, now_s, True
        stop = False
        if missed:
            self._to_repeat -= 1
        elif not self.at_rest:
            self._brake()
        elif self._to_settle > 0:
            self._to_settle -= 1
        else:
            stop = True
            self._to_stop -= 1
        self.over = (self.at_rest and self._is_done) or self._to_repeat < 0
        self.replies += 1
        values = [q * per for q, per in zip(self.correction, self._plan.commanded, strict=True)]
        pool: tuple[object, ...] = (*values, *self._record.outputs, telegram.ipoc, stop)
        return self._template % tuple([pool[place] for place in self._plan.places])

    def _brake(self) -> None:
        """The next setpoint of the brake; if the last check refuses it, the robot stays."""
        record, plan = self._record, self._plan
        self._step += 1
        share = (record.brake_cycles - self._step) / record.brake_cycles
        correction = tuple([q + dq * share for q, dq in zip(self.correction, record.plan_dq, strict=True)])
        if reply_fault(correction, self.correction, plan.most, record.lower, record.upper) is None:
            self.correction = correction
        else:
            self._step = record.brake_cycles
